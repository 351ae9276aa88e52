"""`twin study` and `twin compare` as a user meets them, with real worlds."""

from __future__ import annotations

import csv
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest

from logs.mcap_reader import read
from planner.solve import SolveParams
from tests.cli_tools import AISLE, DRAWN, HALL, files_below, twin
from twin.instance import open_instance
from twin.pipeline import make_plan
from twin.study import plan_study, run_study
from twin.study_engine import LocalEngine
from twin.study_store import FolderStore

ROOT = Path(__file__).parents[2]
STUDY = """\
format = "mapp-study/1"
[study]
name = "A <b>small</b> study"
story = "What if the right access point fails?"
world = "drawn.toml"
run = "plan"
replications = 3
seed = 4
baseline = "now"
[factors]
"plan.objective" = ["hp", "tp"]
[[scenario]]
name = "now"
[[scenario]]
name = "right off"
about = "one access point less"
set = { "ap.right.enabled" = false }
[kpi]
columns = ["success", "cost", "handovers_per_robot", "ap_peak.right"]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with worlds, a study, and the study's results in `out`."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "hall.toml").write_text(HALL)
    (folder / "drawn.toml").write_text(DRAWN)
    (folder / "aisle.toml").write_text(AISLE)
    (folder / "study.toml").write_text(STUDY)
    outcome = twin("study", folder / "study.toml", "-o", folder / "out", "--jobs", 1)
    (folder / "said.txt").write_text(f"{outcome.code}\n{outcome.out}\n---\n{outcome.err}")
    return folder


def rows(folder: Path) -> list[dict[str, str]]:
    """The rows of a study."""
    with (folder / "runs.csv").open() as file:
        return list(csv.DictReader(file))


def without_seconds(folder: Path) -> list[dict[str, str]]:
    """Rows as they must be every time."""
    return [{k: v for k, v in r.items() if "seconds" not in k} for r in rows(folder)]


def test_a_study_says_and_writes_what_it_promises(place):
    """Tables on stdout, nothing on stderr, all four files, exit 0 or 1 by the runs."""
    code, _, said = (place / "said.txt").read_text().partition("\n")
    said, _, err = said.partition("\n---\n")
    found = rows(place / "out")
    assert len(found) == 12
    assert err == ""
    assert code == ("0" if all(r["status"] == "ok" for r in found) else "1")
    assert "12 runs:" in said
    assert files_below(place / "out") == {
        "runs.csv",
        "summary.csv",
        "report.html",
        "study.lock.toml",
    }


def test_a_row_is_what_the_planner_says_of_that_world(place):
    """Every row can be had by `twin plan --seed` and the same settings: the same figures."""
    for r in rows(place / "out")[:4]:
        overrides: dict[str, object] = {"plan.objective": r["plan.objective"]}
        if r["scenario"] == "right off":
            overrides["ap.right.enabled"] = False
        instance = open_instance(place / "drawn.toml", overrides=overrides, seed=int(r["seed"]))
        plan = make_plan(instance.problem, SolveParams(seed=int(r["seed"])))
        assert r["cost"] == ("" if plan.unserved else str(plan.cost))
        if r["cost"]:
            assert float(r["handovers_per_robot"]) == plan.handovers / 4
        assert (r["ap_peak.right"] == "") == (r["scenario"] == "right off" or not r["cost"])


def test_common_random_numbers_make_the_same_instance_in_every_scenario(place):
    """In one replication robots have the same errands, whatever is varied."""
    pairs = {}
    for horizon in (25, 40):
        instance = open_instance(place / "drawn.toml", overrides={"plan.horizon": horizon}, seed=4)
        pairs[horizon] = (instance.problem.start.tolist(), instance.problem.goal.tolist())
    assert pairs[25] == pairs[40]


def test_summary_means_are_those_of_the_rows(place):
    """summary.csv recomputed from runs.csv by other means."""
    found = rows(place / "out")
    with (place / "out/summary.csv").open() as file:
        for line in csv.DictReader(file):
            mine = [
                float(r[line["kpi"]])
                for r in found
                if r["scenario"] == line["scenario"]
                and r["plan.objective"] == line["plan.objective"]
                and r[line["kpi"]]
            ]
            assert int(line["n"]) == len(mine)
            if mine:
                assert float(line["mean"]) == pytest.approx(sum(mine) / len(mine))


def test_the_lock_file_has_all_that_was_resolved(place):
    """Versions, seeds, every cell with a world that can be read again."""
    lock = tomllib.loads((place / "out/study.lock.toml").read_text())
    assert lock["versions"]["numpy"]
    assert lock["seeds"]["replication"] == [4, 5, 6]
    assert [c["levels"]["plan.objective"] for c in lock["cell"]] == ["hp", "tp", "hp", "tp"]
    world = place / "again.toml"
    world.write_text(lock["world"][lock["cell"][3]["world"]])
    instance = open_instance(world, seed=4)
    assert instance.problem.objective == "tp"
    assert instance.problem.ap_ids == ("left",)


def test_the_report_is_one_file_that_explains_itself(place):
    """Title, question, scenarios, causes, figures inside, versions; no script, nothing loaded."""
    page = (place / "out/report.html").read_text()
    assert "<title>A &lt;b&gt;small&lt;/b&gt; study</title>" in page
    assert "<b>small</b>" not in page
    assert "What if the right access point fails?" in page
    assert "one access point less" in page
    assert page.count("data:image/svg+xml;base64,") >= 2 * 3
    assert "<script" not in page
    assert not re.findall(r"""(?:src|href)=["'](?!data:|logs/)""", page)
    assert "Differences to the baseline" in page
    assert "numpy" in page


def test_results_do_not_depend_on_the_number_of_workers(place):
    """Two workers, one worker: the same runs.csv but for the seconds, in the same order."""
    twin("study", place / "study.toml", "-o", place / "two", "--jobs", 2)
    assert without_seconds(place / "two") == without_seconds(place / "out")


def test_refusals(place, tmp_path):
    """Existing results, a wrong kind of file, options that exclude one another: exit code 2."""
    for args, said in (
        (("study", place / "study.toml", "-o", place / "out"), "holds a study already"),
        (("study", place / "hall.txt"), "is not a study file"),
        (("study", place / "none.toml"), "there is no such file"),
        (("study", place / "study.toml", "--resume", "--overwrite"), "choose one"),
        (("study", place / "study.toml", "--jobs", 2, "--cluster", "tcp://x:1"), "choose one"),
        (("study", place / "study.toml", "-o", place / "hall.toml"), "is a file"),
        (("compare", place / "out", tmp_path), "holds no study"),
        (("compare", place / "out", place / "none"), "is no folder"),
        (("compare", place / "out", place / "out", "--kpi", "cots"), "did you mean 'cost'"),
    ):
        outcome = twin(*args)
        assert outcome.code == 2, (args, outcome.out)
        assert said in outcome.err, outcome.err
        assert outcome.err.startswith("error: ")
        assert "Traceback" not in outcome.err


def test_resume_of_a_finished_study_runs_nothing_and_more_replications_only_these(place):
    """`--resume` keeps every row; `--replications` adds the missing ones."""
    shutil.copytree(place / "out", place / "more")
    before = rows(place / "more")
    twin("study", place / "study.toml", "-o", place / "more", "--jobs", 1, "--resume")
    assert rows(place / "more") == before
    args = ("study", place / "study.toml", "-o", place / "more", "--jobs", 1, "--resume")
    twin(*args, "--replications", 4)
    after = rows(place / "more")
    assert after[:12] == before
    assert len(after) == 16
    fewer = twin(*args, "--replications", 2)
    assert fewer.code == 2
    assert "are none of this study as it is now" in fewer.err


def test_list_says_what_would_be_run_and_runs_nothing(place):
    """`--list` names every variant and the number of runs, as JSON with their ids."""
    outcome = twin("study", place / "study.toml", "--list", "-o", place / "never")
    assert outcome.code == 0
    assert "4 variants in 3 replications: 12 runs" in outcome.out
    assert "right off, plan.objective = tp" in outcome.out
    listed = twin("study", place / "study.toml", "--list", "--json").json
    assert listed["seeds"] == [4, 5, 6]
    ids = {r["run"] for r in rows(place / "out")}
    assert {run for cell in listed["cells"] for run in cell["runs"]} == ids
    assert not (place / "never").exists()


def test_json_gives_the_summary(place):
    """`--json` on stdout: statuses, means, differences."""
    args = ("study", place / "study.toml", "-o", place / "out", "--resume", "--json")
    values = twin(*args).json
    assert values["runs"] == 12
    assert sum(values["statuses"].values()) == 12
    cost = [e for e in values["summary"] if e["kpi"] == "cost" and e["scenario"] == "right off"]
    assert all(e["difference"]["pairs"] <= 3 for e in cost)


def test_compare_of_a_study_with_itself_shows_no_difference(place):
    """All differences 0 with as many pairs as values; `--sure` shows none."""
    values = twin("compare", place / "out", place / "out", "--json").json
    assert all(c["difference"] in (0, None) for c in values["changes"])
    assert values["turned"] == []
    text = twin("compare", place / "out", place / "out", "--sure")
    assert text.code == 0
    assert "no difference to show" in text.out


def test_failed_runs_are_rows_with_their_cause(place):
    """Infeasible by proof, a world broken in one scenario, one that covers nobody: rows, exit 1."""
    study = place / "failing.toml"
    study.write_text(
        'format = "mapp-study/1"\n[study]\nworld = "aisle.toml"\nrun = "plan"\n[[scenario]]\n'
        'name = "stuck"\n[[scenario]]\nname = "dark"\nset = {"ap.ap0.enabled" = false}\n'
        '[[scenario]]\nname = "leave"\nset = {"robot.west.start" = {cell = [1, 0]}, '
        '"robot.west.goal" = {cell = [4, 0]}, "plan.at_goal" = "leave"}\n'
    )
    outcome = twin("study", study, "-o", place / "failed", "--jobs", 1)
    assert outcome.code == 1
    found = {r["scenario"]: r for r in rows(place / "failed")}
    assert found["stuck"]["status"] in {"infeasible", "unserved"}
    assert found["dark"]["status"] == "broken"
    assert "every access point is switched off" in found["dark"]["error"]
    assert found["leave"]["status"] == "ok"
    assert [found[s]["success"] for s in ("stuck", "dark", "leave")] == ["0", "0", "1"]
    page = (place / "failed/report.html").read_text()
    assert "every access point is switched off" in page


def test_executed_runs_leave_the_logs_that_were_asked_for(place):
    """`mcap = "first"`: a log for the first replication of each variant, readable and linked."""
    study = place / "executed.toml"
    study.write_text(
        'format = "mapp-study/1"\n[study]\nworld = "hall.toml"\nreplications = 2\n[factors]\n'
        '"plan.objective" = ["hp", "tp"]\n[log]\nmcap = "first"\nvalidate_logs = true\n'
    )
    outcome = twin("study", study, "-o", place / "logs", "--jobs", 1)
    found = rows(place / "logs")
    assert outcome.code == 0, found
    assert [bool(r["log"]) for r in found] == [True, True, False, False]
    for r in found[:2]:
        run = read(place / "logs" / r["log"])
        assert run.plan.cost == int(r["cost"])
        assert r["log"] in (place / "logs/report.html").read_text()
    assert all(float(r["outage_s"]) >= 0 for r in found)


def test_a_defect_of_a_run_is_a_row(place, tmp_path):
    """An exception nobody expected names its type and its line; the study goes on."""
    grid = plan_study(place / "study.toml", replications=1)
    with FolderStore(tmp_path / "out") as store:
        results = run_study(
            grid, store, LocalEngine(1), function="tests.twin.test_study_cli:stumble"
        )
    assert {row.status for row in results.rows} == {"defect"}
    assert all("KeyError at test_study_cli.py:" in row.error for row in results.rows)


def stumble(task):
    """A run in which something breaks that is no fault of the world."""
    from twin import study_run

    def survey(_task):
        raise KeyError("nowhere")

    study_run._instance = survey
    return study_run.run_task(task)


# --- stopped in the middle ------------------------------------------------------------------------


def tiny_study(folder: Path, runs: int) -> Path:
    """A study of many tiny runs."""
    (folder / "hall.toml").write_text(HALL)
    path = folder / "many.toml"
    path.write_text(
        f'format = "mapp-study/1"\n[study]\nworld = "hall.toml"\nrun = "plan"\nreplications = '
        f'{runs // 4}\n[factors]\n"plan.horizon" = [20, 25]\n"plan.objective" = ["hp", "tp"]\n'
        '[planner]\niterations = 10\n[kpi]\ncolumns = ["success", "cost"]\n'
    )
    return path


COMMAND = "from twin.cli import main; main()"
QUICK_RUNS = (
    "import twin.study as s; s.run_study.__kwdefaults__['function'] = "
    "'tests.twin.study_tasks:slow_figure';"
)
"""The command with runs that need no planner: what is tested is what happens between runs."""


def started(study: Path, out: Path, *options: str, before: str = "") -> subprocess.Popen[str]:
    """The command in a process of its own."""
    args = ["study", str(study), "-o", str(out), "--jobs", "2", *options]
    return subprocess.Popen(
        [sys.executable, "-c", before + COMMAND, *args],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def lines(out: Path) -> int:
    """Lines of runs.csv so far."""
    try:
        return (out / "runs.csv").read_bytes().count(b"\n")
    except FileNotFoundError:
        return 0


def stop_after(process: subprocess.Popen[str], out: Path, wanted: int, how: int) -> None:
    """Send a signal once so many lines are there."""
    until = time.monotonic() + 120
    while lines(out) < wanted:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < until
        time.sleep(0.01)
    os.kill(process.pid, how)


def test_a_study_killed_three_times_and_resumed_has_the_rows_of_an_undisturbed_one(tmp_path):
    """200 tiny runs, SIGKILL three times: no row lost, none twice, none other."""
    study = tiny_study(tmp_path, 200)
    whole = started(study, tmp_path / "whole", before=QUICK_RUNS)
    assert whole.wait(240) == 0, whole.stderr.read()
    out = tmp_path / "killed"
    kept = 0
    for k, wanted in enumerate((30, 90, 150)):
        process = started(study, out, *(["--resume"] if k else []), before=QUICK_RUNS)
        stop_after(process, out, wanted, signal.SIGKILL)
        process.communicate()
        assert lines(out) >= kept
        kept = lines(out)
    last = started(study, out, "--resume", before=QUICK_RUNS)
    assert last.wait(240) == 0, last.stderr.read()
    assert without_seconds(out) == without_seconds(tmp_path / "whole")
    assert len(without_seconds(out)) == 200


def test_ctrl_c_ends_cleanly_and_keeps_what_has_ended(tmp_path):
    """SIGINT: exit 130, a sentence that says how to go on, whole rows, no process left."""
    study, out = tiny_study(tmp_path, 200), tmp_path / "out"
    process = started(study, out)
    stop_after(process, out, 20, signal.SIGINT)
    begin = time.monotonic()
    said, err = process.communicate(timeout=60)
    assert time.monotonic() - begin < 15
    assert process.returncode == 130
    assert re.search(r"interrupted; \d+ of 200 runs are kept in .*--resume", err)
    assert "Traceback" not in err + said
    assert (out / "runs.csv").read_bytes().endswith(b"\n")
    assert not list(tmp_path.rglob("*.part"))
