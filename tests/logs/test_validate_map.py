"""The radio map of a log is derived anew from the world the log carries, its survey among it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from logs.mcap_format import RADIO_MAP_NAME, WORLD_NAME
from logs.validate import validate
from tests.logs.good_logs import folder, log_of
from tests.logs.tamper import edited, forge, rules
from tests.worlds.lifs import write_world
from worlds.radio_map import RadioMap

RULE = "page6:radio-map"


@cache
def lif_log() -> Path:
    """A run on a graph with one-way lanes, its radio measured at two nodes."""
    rows = [f"{x},{y},west,{v}" for x, y in ((5, 2), (11, 2)) for v in (20.25, 21.5, 30.0)]
    (folder() / "s.csv").write_text("\n".join(["x,y,ap,snr_db", *rows]))
    path = write_world(folder(), ("[plan]", '[radio]\nmeasured = "s.csv"\n[plan]'))
    # The world as its file is read, files taken in; a log is made of that.
    from worlds.toml_file import dump_world, read_world

    return log_of(world=dump_world(read_world(path)))


def test_a_run_on_lanes_with_measured_radio_is_valid() -> None:
    """No finding in a run with one-way lanes of several slots; the log alone is enough."""
    report = validate(lif_log())
    assert report.findings == ()
    assert report.rules[2, RULE] > 50


def _changed(field: str, index: tuple[int, ...], by: float) -> bytes:
    from logs.mcap_reader import read

    found = read(lif_log()).radio_map
    array = np.array(getattr(found, field))
    array[index] += by
    return replace(found, **{field: array}).to_bytes()


@pytest.mark.parametrize(
    ("field", "index"), [("snr_db", (3, 1)), ("edge_snr_db", (2, 2, 0)), ("fading_db", (4, 0))]
)
def test_a_forged_map_is_found(tmp_path: Path, field: str, index: tuple[int, ...]) -> None:
    """A thousandth of a decibel, anywhere in the map."""
    change = edited(RADIO_MAP_NAME, lambda _: _changed(field, index, 0.001))
    report = validate(forge(lif_log(), tmp_path / "f.mcap", attachment=change))
    found = [f for f in report.findings if f.rule == RULE]
    assert len(found) == 1
    assert f"{field} at {list(index)}" in str(found[0].found)


def test_a_forged_survey_is_found(tmp_path: Path) -> None:
    """A measurement changed in the world of the log gives another map than the log's."""
    change = edited(WORLD_NAME, lambda data: data.replace(b"west,21.5", b"west,26.5"))
    report = validate(forge(lif_log(), tmp_path / "f.mcap", attachment=change))
    assert RULE in rules(report)


def test_a_forged_world_reads_no_file(tmp_path: Path) -> None:
    """A log that names a file instead of carrying its contents is refused, the file unread."""
    (tmp_path / "secret.json").write_text("{}")

    def named(data: bytes) -> bytes:
        head, rest = data.decode().split("[hall.graph]", 1)
        tail = rest[rest.index("[hall.body]") :]
        return f'{head}[hall.graph]\nlif = "{tmp_path}/secret.json"\n\n{tail}'.encode()

    change = edited(WORLD_NAME, named)
    report = validate(forge(lif_log(), tmp_path / "f.mcap", attachment=change))
    words = [str(f.found) for f in report.findings]
    assert any("which only a world read from a file can name" in text for text in words), words


def test_maps_of_grids_are_derived_anew_as_well(tmp_path: Path) -> None:
    """Shadow fading is drawn again from its seed."""
    log = log_of(options=(("radio.shadow_fading", True), ("radio.tx_power_dbm", 20.0)))
    assert validate(log).findings == ()

    def other(data: bytes) -> bytes:
        found = RadioMap.from_bytes(data)
        return replace(found, fading_db=np.zeros_like(found.fading_db)).to_bytes()

    report = validate(forge(log, tmp_path / "f.mcap", attachment=edited(RADIO_MAP_NAME, other)))
    assert RULE in rules(report)
