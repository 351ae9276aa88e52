"""Findings about measurements: W210 and W211."""

from __future__ import annotations

import numpy as np

from worlds.check import Finding, Site, places
from worlds.radio_map import RadioMap, build_radio_map
from worlds.survey import at_vertices, compare, gap_texts, survey_of

FAR_DB = 10.0

KEY = ("radio", "measured")


def survey_findings(site: Site, radio_map: RadioMap) -> list[Finding]:
    """All of them; none for a world without measurements."""
    how = site.sound.radio.measured
    survey = survey_of(site.sound)
    if how is None or survey is None:
        return []
    floor, ids = site.floor, radio_map.ap_ids
    found = at_vertices(survey, floor, ids, how)
    gap = np.isnan(found.snr_db)
    findings = []
    if gap.any():
        lacking = np.flatnonzero(gap.any(axis=1))
        first = gap_texts(floor, ids, found, how)[0]
        share = gap.mean()
        effect = "the model stands in" if how.gaps == "model" else "they count as uncovered"
        message = f"{share:.0%} of (position, access point) lack measurements, {effect}: {first}"
        findings.append(Finding("W210", message, KEY, places(floor.vertex_xy_m[lacking])))
    if gap.all():
        return findings
    radio = site.sound.radio.model_copy(update={"measured": None})
    model = build_radio_map(site.sound.model_copy(update={"radio": radio}), floor, exact=False)
    at = {ap.id: i for i, ap in enumerate(site.world.ap)}
    for row in compare(survey, floor, model, how)[1:]:
        if abs(row.mean_db) <= FAR_DB:
            continue
        better = "better" if row.mean_db > 0 else "worse"
        message = (
            f"'{row.ap}' is measured {abs(row.mean_db):.0f} dB {better} than the model on average, "
            f"at {row.places} positions; are its place, power and id right? `twin radio --compare` "
            "tells more"
        )
        findings.append(Finding("W211", message, ("ap", at[row.ap])))
    return findings
