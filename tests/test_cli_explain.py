"""`twin plan --prices` and `--explain`: what is drawn, said and refused."""

from __future__ import annotations

import json

from tests.cli_tools import AISLE, DRAWN, HALL, files_below, hall, twin

__all__ = ["hall"]


def test_prices_are_drawn_and_stored(hall, tmp_path):
    """The picture, the key in plan.json, and the advice in both answers."""
    done = twin("plan", hall, "--prices", "p.png", "-o", "plan.json")
    assert done.code == 0, done.err
    assert "prices: p.png" in done.out
    assert "advice" in done.out
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    stored = json.loads((tmp_path / "plan.json").read_text())["prices"]
    assert {"vertices", "edges", "aps", "advice"} <= stored.keys()
    answer = twin("plan", hall, "--prices", "q.svg", "--json")
    assert answer.json["prices_file"] == "q.svg"
    assert answer.json["plan"]["advice"] == stored["advice"]


def test_prices_of_a_problem_file_are_drawn_without_a_hall(hall, tmp_path):
    """A problem.json has no walls and no places of APs, but it has metres."""
    from planner.json_files import dump_problem
    from twin.instance import open_instance

    (tmp_path / "problem.json").write_text(dump_problem(open_instance(hall).problem))
    done = twin("plan", "problem.json", "--prices", "p.png")
    assert done.code == 0, done.err
    assert (tmp_path / "p.png").exists()


def test_prices_that_cannot_be_drawn_are_refused_before_the_work(hall, tmp_path):
    """Another ending, a file that exists, a method without prices: exit 2 and nothing written."""
    before = files_below(tmp_path)
    for args, said in (
        (("--prices", "p.pdf"), "must end in .png or .svg"),
        (("--prices", "hall.toml"), "must end in .png or .svg"),
        (("--prices", "p.png", "--method", "cooperative"), "computes no prices"),
    ):
        refused = twin("plan", hall, *args)
        assert refused.code == 2
        assert said in refused.err
    assert files_below(tmp_path) == before
    (tmp_path / "p.png").write_text("mine")
    assert twin("plan", hall, "--prices", "p.png").code == 2
    assert (tmp_path / "p.png").read_text() == "mine"


def test_aisle_for_one_is_explained(hall, tmp_path):
    """Two robots head-on in a lane for one: why, and that neither slots nor APs help; exit 1."""
    (tmp_path / "aisle.toml").write_text(AISLE)
    said = twin("plan", "aisle.toml", "--explain", "--prices", "p.png")
    assert said.code == 1
    words = " ".join(said.out.replace("│", " ").split())
    assert "east ((1, 1) m to (9, 1) m) and west ((9, 1) m to (1, 1) m) cannot get past" in words
    assert "no horizon is long enough: proven" in words
    assert not (tmp_path / "p.png").exists() or "prices: p.png" in said.out
    plain = twin("plan", "aisle.toml")
    assert "--explain says why" in plain.out
    values = twin("plan", "aisle.toml", "--explain", "--json").json["explanation"]
    assert values["status"] == "infeasible"
    assert values["pairs"][0]["robots"] == ["east", "west"]


def test_run_without_a_plan_points_to_the_explanation(hall, tmp_path):
    """Nothing is run, and the hint says how to learn why."""
    (tmp_path / "aisle.toml").write_text(AISLE)
    assert "--explain says why" in " ".join(twin("run", "aisle.toml").out.split())


def test_short_horizon_names_the_least(hall):
    """Too far for the horizon: the least one is named and is enough when it is taken."""
    values = twin("plan", hall, "--set", "plan.horizon=3", "--explain", "--json").json
    least = values["explanation"]["least_horizon"]
    assert least["lower"] == least["upper"]
    enough = twin("plan", hall, "--set", f"plan.horizon={least['upper']}", "--json")
    assert enough.code == 0
    short = twin("plan", hall, "--set", f"plan.horizon={least['upper'] - 1}", "--json")
    assert short.code == 1


def test_few_ap_places_name_the_least_capacity(hall, tmp_path):
    """Four robots and room for two in all: the APs are named, and the capacity that is enough."""
    (tmp_path / "drawn.toml").write_text(DRAWN)
    said = twin("plan", "drawn.toml", "--set", "radio.ap_capacity=1", "--explain", "--json").json
    assert said["plan"]["status"] == "infeasible"
    parts = said["explanation"]["bottleneck"]["parts"]
    assert {part["kind"] for part in parts} == {"ap"}
    least = said["explanation"]["least_ap_capacity"]
    assert least["upper"] is not None
    setting = f"radio.ap_capacity={least['upper']}"
    assert twin("plan", "drawn.toml", "--set", setting, "--json").code == 0


def test_good_plan_needs_no_explanation(hall):
    """Exit 0, and the sentence says that there is nothing to explain."""
    said = twin("plan", hall, "--explain")
    assert said.code == 0
    assert "nothing to explain" in said.out
    assert HALL in hall.read_text()


def test_run_gives_the_advice_as_a_hint(hall, tmp_path):
    """`twin run` tells what room is worth, where any is short; it is in the log, too."""
    (tmp_path / "drawn.toml").write_text(DRAWN)
    done = twin("run", "drawn.toml", "--set", "robots.random.count=9", "-o", "out", "--json")
    assert done.code == 0, done.err
    from logs.mcap_reader import read

    prices = read(tmp_path / "out/run.mcap").plan.prices
    assert done.json["plan"]["advice"] == prices.advice
    assert (prices.advice in done.json["hints"]) == (prices.total > 0)
