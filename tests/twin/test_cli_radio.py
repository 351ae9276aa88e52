"""`twin radio` as a user meets it: requirements, tables, one point, a plan's handovers."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from tests.cli_tools import files_below, hall, twin

__all__ = ["hall"]  # a fixture


def test_requirements_decide_the_exit_code(hall: Path) -> None:
    """0 if all are met, 1 if one is missed; each is told with the share reached."""
    done = twin("radio", hall, "--require", "50%", "--json")
    assert done.code == 0
    (met,) = done.json["requirements"]
    assert met["met"]
    assert met["reached"] == pytest.approx(done.json["covered"] / done.json["positions"])
    done = twin("radio", hall, "--require", "0.5", "--require", "100%@60x2")
    assert done.code == 1
    assert "100.0 % with 60 dB from 2 APs: 0.00 %, MISSED" in done.out
    assert "50.0 % with 10 dB" in done.out


@pytest.mark.parametrize("text", ["most", "101%", "1.2", "95%x0", "95%@", "-1"])
def test_wrong_requirements_are_refused(hall: Path, text: str) -> None:
    """Each with its form; nothing is computed."""
    done = twin("radio", hall, "--require", text)
    assert done.code == 2
    assert f"--require {text}: must be a share of the positions" in done.err


def test_the_csv_has_a_row_per_position_and_ap(hall: Path) -> None:
    """As many rows as the map has links, best first; not overwritten unless told."""
    done = twin("radio", hall, "--csv", "out/radio.csv", "--json")
    assert done.code == 0, done.err
    rows = list(csv.DictReader(Path("out/radio.csv").read_text().splitlines()))
    assert len(rows) == 2 * done.json["positions"]
    assert sum(row["covered"] == "1" for row in rows) == sum(a["covers"] for a in done.json["aps"])
    again = twin("radio", hall, "--csv", "out/radio.csv")
    assert again.code == 2
    assert "exists already" in again.err
    assert twin("radio", hall, "--csv", "radio.txt").code == 2


def test_a_point_is_explained(hall: Path) -> None:
    """A column per access point with every term; who blocks, and whether it is covered."""
    done = twin("radio", hall, "--at", "7", "1")
    assert done.code == 0, done.err
    for part in (
        "distance [m]",
        "loss: frequency [dB]",
        "= SNR [dB]",
        "line of sight",
        "covered by",
    ):
        assert part in done.out
    values = twin("radio", hall, "--at", "7", "7", "--json").json
    links = {link["ap"]: link for link in values["links"]}
    assert links["left"]["blocker"] == "rack"
    assert links["right"]["line_of_sight"]
    assert values["best_ap"] == "right"
    assert values["covered"]
    dark = twin("radio", hall, "--at", "7", "7", "--set", "radio.tx_power_dbm=-60")
    assert dark.code == 1
    assert "not covered: the best is right" in dark.out


def test_a_point_nobody_can_stand_at_is_refused(hall: Path) -> None:
    """Outside, or in the rack; and --at goes with nothing that shows the whole map."""
    assert "is outside the hall" in twin("radio", hall, "--at", "70", "7").err
    assert "inside 'rack'" in twin("radio", hall, "--at", "5", "5").err
    done = twin("radio", hall, "--at", "7", "7", "-o", "x.png")
    assert done.code == 2
    assert "--at explains one point" in done.err
    assert files_below(hall.parent) == {"hall.toml"}


def test_a_run_with_all_physics_is_valid_and_its_handovers_are_shown(hall: Path) -> None:
    """Planned, driven and checked with every switch on: the validator meets the same SNRs.

    `--plan` shows as many handovers for plan.json as for the run, between the same access points.
    """
    switches = (
        "radio.shadow_fading=true",
        "radio.fading_correlation=table",
        "radio.oxygen=true",
        "radio.blockage=knife-edge",
        "radio.low_antenna_los_db=1.5",
        "ap.left.antenna={azimuth_deg=10,tilt_deg=20,beamwidth_deg=120}",
        "radio.tx_power_dbm=20",
    )
    options = [part for switch in switches for part in ("--set", switch)]
    done = twin("run", hall, *options, "--method", "cooperative", "-o", "run")
    assert done.code == 0, done.out + done.err
    assert "log validated" in done.out
    of_plan = twin("radio", hall, *options, "--plan", "run/plan.json", "--json")
    assert of_plan.code == 0, of_plan.err
    of_run = twin("radio", hall, *options, "--plan", "run/run.mcap", "-o", "map.svg", "--json")
    assert of_run.code == 0, of_run.err
    planned, driven = of_plan.json["handovers"], of_run.json["handovers"]
    assert planned["count"] == driven["count"] == len(driven["places"]) > 0
    for key in ("from", "to"):
        told = [sorted(place[key] for place in p["places"]) for p in (planned, driven)]
        assert told[0] == told[1]
    assert Path("map.svg").read_text().startswith("<?xml")
    table = twin("radio", hall, *options, "--plan", "run/plan.json")
    assert f"{planned['count']} in plan.json" in table.out
    assert twin("radio", hall, "--plan", hall).code == 2


def test_a_log_of_other_physics_is_not_valid(hall: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: a twin that forgets oxygen is found out by the validator, sample by sample."""
    from worlds import channel

    true = channel.oxygen_db
    monkeypatch.setattr(channel, "oxygen_db", lambda d, f: 3.0 + true(d, f))
    options = ("--set", "radio.oxygen=true", "--set", "radio.tx_power_dbm=20")
    assert twin("run", hall, *options, "--method", "cooperative", "-o", "run").code == 0
    monkeypatch.undo()
    monkeypatch.chdir(hall.parent)
    done = twin("validate", "run/run.mcap", "--json")
    assert done.code == 1
    assert any(f["rule"] == "page5:snr" for f in done.json["findings"])
