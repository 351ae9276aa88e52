"""The `twin` command as a user meets it: what it prints, what it writes, its exit codes."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from logs.mcap_reader import canonical_hash, read
from logs.mcap_writer import RunLog
from logs.records import Kpi
from planner.check import check_plan
from planner.json_files import dump_problem, read_plan, read_problem
from tests.cli_tools import AISLE, DRAWN, files_below, good_run, hall, twin
from twin import cli, instance, pipeline
from worlds.toml_file import open_world

__all__ = ["good_run", "hall"]  # fixtures

# --- twin run -----------------------------------------------------------------------------------


def test_run_goes_the_whole_road(hall):
    """`twin run` ends with a table, a sentence, a valid log, a layout, a picture and a plan."""
    done = twin("run", hall)
    assert done.code == 0, done.err
    out = Path("runs/hall")
    assert files_below(out) == {"run.mcap", "run.layout.json", "hall.png", "plan.json"}
    assert (out / "hall.png").read_bytes().startswith(b"\x89PNG")
    assert "configById" in json.loads((out / "run.layout.json").read_text())
    for word in ("cost", "lower bound", "gap", "handovers", "seconds", "runs/hall/run.mcap"):
        assert word in done.out
    last = done.out.strip().splitlines()[-1]
    assert last.startswith("plan cost ")
    assert "optimal" in last
    assert "no collision, no overload" in last
    assert last.endswith("log validated")
    assert done.err == ""


def test_run_as_json_prints_one_document_and_nothing_else(good_run):
    """`--json` puts the whole result on stdout and leaves stderr empty."""
    folder, done = good_run
    result = done.json
    assert done.err == ""
    assert result["succeeded"] is True
    assert result["validation"]["valid"] is True
    assert result["execution"]["kpi"]["arrived"] == result["instance"]["robots"] == 2
    assert result["plan"]["cost"] >= result["plan"]["lower_bound"] > 0
    assert list(result["seconds"]) == [
        "world",
        "radio map",
        "plan",
        "run",
        "validation",
        "picture",
    ]
    assert {Path(p).name for p in result["files"].values()} == files_below(folder)


def test_run_reports_what_its_log_says(good_run):
    """Cost, handovers and key figures that are printed are those in the log (§1.9, §1.13)."""
    folder, done = good_run
    run = read(folder / "run.mcap")
    assert run.plan.cost == done.json["plan"]["cost"]
    assert check_plan(run.problem, run.plan) == []
    assert run.of(Kpi)[-1].handovers == done.json["execution"]["kpi"]["handovers"]
    assert done.json["plan"]["handovers"] == run.plan.handovers
    assert read_plan(folder / "plan.json", run.problem).cost == run.plan.cost


def test_run_twice_gives_the_same_log(hall, good_run):
    """Same world, same seed: the same plan and the same records (§1.15)."""
    assert twin("run", hall, "-o", "again").code == 0
    assert canonical_hash(Path("again/run.mcap")) == canonical_hash(good_run[0] / "run.mcap")


def test_seed_makes_another_instance_of_the_family(hall):
    """`--seed` draws other errands; the same seed draws the same; one `--set` seed wins."""
    hall.write_text(DRAWN)

    def errands(*options):
        assert twin("run", hall, *options, "--overwrite", "-o", "out").code == 0
        problem = read(Path("out/run.mcap")).problem
        return [*problem.start.tolist(), *problem.goal.tolist()]

    first = errands("--seed", 1)
    assert errands("--seed", 1) == first
    assert errands("--seed", 2) != first
    assert errands("--seed", 2, "--set", "robots.random.seed=1") == first


def test_seed_replaces_every_seed_of_the_world(hall):
    """All streams follow `--seed`: fading, planner, run, and what the world draws."""
    hall.write_text(DRAWN)
    assert twin("run", hall, "--seed", 7, "-o", "out").code == 0
    world = read(Path("out/run.mcap")).world
    seeds = (world.radio.fading_seed, world.plan.seed, world.run.seed, world.robots.random.seed)
    assert seeds == (7, 7, 7, 7)


def test_set_changes_the_world_that_is_run(hall):
    """`--set` reaches keys of tables and of named list elements, and the log carries the result."""
    sets = ["--set", "radio.tx_power_dbm=24", "--set", "ap.left.capacity=3"]
    assert twin("run", hall, *sets, "--objective", "tp", "-o", "out").code == 0
    world = read(Path("out/run.mcap")).world
    assert world.radio.tx_power_dbm == 24
    assert world.ap[0].capacity == 3
    assert world.plan.objective == "tp"


def test_stronger_access_points_need_fewer_handovers(hall, good_run):
    """The README's what-if holds: more power, fewer handovers, no dearer plan."""
    assert twin("run", hall, "--set", "radio.tx_power_dbm=30", "-o", "out").code == 0
    weak, strong = read(good_run[0] / "run.mcap").plan, read(Path("out/run.mcap")).plan
    assert weak.handovers > strong.handovers == 0
    assert strong.cost <= weak.cost


def test_run_is_usable_without_the_command(hall):
    """The pipeline is a library: typed results, no output."""
    made = instance.open_instance(hall)
    road = pipeline.travel(made, hall.parent / "lib")
    assert road.succeeded
    assert road.files.log.exists()
    assert road.summary.endswith("log validated")


def test_run_draws_robots_only_where_there_is_coverage(hall):
    """Random errands start and end at covered positions (§1.8)."""
    hall.write_text(DRAWN.replace("tx_power_dbm = 6.0", "tx_power_dbm = -5.0"))
    made = instance.open_instance(hall)
    assert made.problem.n_vertices < len(made.floor.vertex_xy_m)  # there are holes
    assert made.radio_map.covered[made.floor.start].any(axis=1).all()
    assert made.radio_map.covered[made.floor.goal].any(axis=1).all()


# --- the answer is no ---------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["run", "plan"])
def test_infeasible_names_the_robots_and_writes_nothing(hall, command):
    """Too short a horizon: exit 1, the robot is named, no file claims to be a run (§1.12)."""
    before = files_below(hall.parent)
    done = twin(command, hall, "--set", "plan.horizon=6")
    assert done.code == 1
    assert "infeasible" in done.out
    assert "r0" in done.out
    assert "Traceback" not in done.err
    assert files_below(hall.parent) == before


def test_infeasible_as_json(hall):
    """With `--json` the same answer is data, and still exit 1."""
    done = twin("run", hall, "--set", "plan.horizon=6", "--json")
    assert done.code == 1
    assert done.json["plan"]["status"] == "infeasible"
    assert "r0" in done.json["plan"]["infeasible_robots"]
    assert done.json["execution"] is None
    assert done.json["files"] == {}


def test_partial_plan_is_not_run(hall):
    """A plan without a path for everybody is not executed: exit 1 and the robots' names (§1.12)."""
    hall.write_text(AISLE)
    before = files_below(hall.parent)
    done = twin("run", hall, "--method", "cooperative", "--json")
    assert done.code == 1
    assert done.json["plan"]["status"] == "unknown"
    unserved = done.json["plan"]["unserved"]
    assert unserved
    assert all(robot in done.json["summary"] for robot in unserved)
    assert files_below(hall.parent) == before


# --- twin plan ----------------------------------------------------------------------------------


def test_plan_of_a_world_and_of_its_problem_agree(hall, good_run):
    """plan.json of a problem.json costs what the world's does, and keeps every rule (§1.9)."""
    problem = read(good_run[0] / "run.mcap").problem
    Path("problem.json").write_text(dump_problem(problem))
    done = twin("plan", "problem.json", "-o", "plan.json", "--json")
    assert done.code == 0
    plan = read_plan(Path("plan.json"), read_problem(Path("problem.json")))
    assert check_plan(problem, plan) == []
    assert plan.cost == done.json["plan"]["cost"] == good_run[1].json["plan"]["cost"]


@pytest.mark.parametrize("method", ["auto", "pgcp", "cooperative"])
def test_every_method_plans(hall, method):
    """Each method gives a plan of this hall; none claims more than it proves (§1.12)."""
    done = twin("plan", hall, "--method", method, "--json")
    assert done.code == 0
    plan = done.json["plan"]
    assert plan["lower_bound"] <= plan["cost"]
    assert plan["status"] in {"optimal", "feasible"}


def test_objective_of_a_problem_file_can_be_replaced(hall, good_run):
    """`--objective 1,0` prices handovers at nothing, for a world and a problem.json alike."""
    problem = read(good_run[0] / "run.mcap").problem
    Path("problem.json").write_text(dump_problem(problem))
    costs = {}
    for source in (hall, Path("problem.json")):
        done = twin("plan", source, "--objective", "1,0", "--json")
        assert done.code == 0
        assert (done.json["problem"]["c_t"], done.json["problem"]["c_h"]) == (1, 0)
        assert done.json["plan"]["cost"] == done.json["plan"]["slots"]
        costs[source] = done.json["plan"]["cost"]
    assert len(set(costs.values())) == 1


def test_plan_table_ends_in_words(hall):
    """Without `--json`: a table and a sentence."""
    done = twin("plan", hall, "--iterations", 10)
    assert done.code == 0
    assert "lower bound" in done.out
    assert done.out.strip().splitlines()[-1].startswith("plan cost ")


# --- twin radio, validate, info -----------------------------------------------------------------


def test_radio_counts_and_draws(hall):
    """`twin radio` counts every free position once and draws the map."""
    done = twin("radio", hall, "-o", "maps/radio.png", "--json")
    assert done.code == 0, done.err
    assert Path("maps/radio.png").read_bytes().startswith(b"\x89PNG")
    result = done.json
    assert sum(result["covered_by"].values()) == result["positions"]
    assert result["covered"] == result["positions"] - len(result["holes"])
    assert [ap["id"] for ap in result["aps"]] == ["left", "right"]
    table = twin("radio", hall)
    assert table.code == 0
    assert f"{result['positions']} free" in table.out


def test_radio_shows_a_hall_without_coverage(hall):
    """The map is what one looks at to find out why nothing is covered: no refusal here."""
    done = twin("radio", hall, "--set", "radio.tx_power_dbm=-200", "--json")
    assert done.code == 0, done.err
    assert done.json["covered"] == 0


def test_validate_accepts_a_good_log(good_run, tmp_path, monkeypatch):
    """A good log: exit 0; JSON and JUnit XML say the same."""
    monkeypatch.chdir(tmp_path)
    log = good_run[0] / "run.mcap"
    done = twin("validate", log, "--json", "out.json", "--junit", "out.xml")
    assert done.code == 0, done.out
    assert json.loads(Path("out.json").read_text())["valid"] is True
    suites = ElementTree.parse("out.xml").getroot()
    assert len(suites) > 0
    assert suites.find(".//failure") is None
    assert "facts checked" in done.out


@pytest.mark.parametrize("order", [["--json"], ["--json", "-"]])
def test_validate_json_without_a_file_is_stdout(good_run, order):
    """`--json` alone means stdout, before and behind the log's name."""
    log = good_run[0] / "run.mcap"
    assert twin("validate", log, *order).json["valid"] is True
    assert twin("validate", *order, log).json["valid"] is True


def test_validate_finds_a_forged_figure(hall, good_run, tmp_path):
    """A log whose last key figures are embellished is sound as a file, and not valid: exit 1."""
    run = read(good_run[0] / "run.mcap")
    world, floor = open_world(hall)
    forged = tmp_path / "forged.mcap"
    last = max(i for i, r in enumerate(run.records) if isinstance(r, Kpi))
    with RunLog(
        forged,
        world=world,
        floor=floor,
        radio_map=run.radio_map,
        problem=run.problem,
        plan=run.plan,
    ) as log:
        for i, record in enumerate(run.records):
            log.write(replace(record, handovers=record.handovers - 1) if i == last else record)
    done = twin("validate", forged)
    assert done.code == 1
    assert "NOT valid" in done.out
    assert "handovers" in done.out


def test_info_says_what_a_log_holds(good_run):
    """`twin info` names world, plan, topics and attachments, as a table and as JSON."""
    log = good_run[0] / "run.mcap"
    done = twin("info", log, "--json")
    assert done.code == 0, done.err
    result = done.json
    assert result["world"] == "test hall"
    assert result["plan"]["cost"] == good_run[1].json["plan"]["cost"]
    assert {"world.toml", "plan.json", "problem.json"} <= set(result["attachments"])
    assert {"/tf", "/samples", "/kpi"} <= {topic["topic"] for topic in result["topics"]}
    table = twin("info", log)
    assert table.code == 0
    assert "test hall" in table.out


def test_help_and_version_answer():
    """Every command explains itself, and the version is told."""
    for command in ("run", "plan", "radio", "validate", "info"):
        done = twin(command, "--help")
        assert done.code == 0
        assert "--debug" in done.out
    assert "mapp-twin" in twin("--version").out
    assert cli.main.__doc__


def test_module_is_the_command():
    """`python -m twin` answers like `twin`, by the same name."""
    done = subprocess.run(
        [sys.executable, "-m", "twin", "plan", "-h"], capture_output=True, text=True, check=True
    )
    assert "Usage: twin plan" in done.stdout
