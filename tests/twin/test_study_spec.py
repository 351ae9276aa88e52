"""Study files: every mistake is told with its line, and what is right becomes the right runs."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest

from tests.cli_tools import DRAWN, HALL
from twin.instance import seed_overrides
from twin.study import plan_study
from twin.study_grid import Grid
from worlds.errors import WorldError
from worlds.toml_file import parse_world

HEAD = 'format = "mapp-study/1"\n[study]\nworld = "hall.toml"\nrun = "plan"\n'


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder with two worlds: listed robots, and drawn ones."""
    (tmp_path / "hall.toml").write_text(HALL)
    (tmp_path / "drawn.toml").write_text(DRAWN)
    return tmp_path


def planned(folder: Path, text: str, **options: object) -> Grid:
    """The grid of a study with this text."""
    path = folder / "study.toml"
    path.write_text(text)
    return plan_study(path, **options)


def refused(folder: Path, text: str) -> tuple[str, ...]:
    """The lines with which a study is refused."""
    with pytest.raises(WorldError) as caught:
        planned(folder, text)
    return caught.value.lines


def test_faults_have_file_and_line_and_all_come_at_once(folder):
    """A misspelt key, an unknown column and a bad number are told together, in file order."""
    lines = refused(
        folder, HEAD + 'replicatons = 3\nseed = -1\n[kpi]\ncolumns = ["success", "handover"]\n'
    )
    places = [line.removeprefix(str(folder)) for line in lines]
    assert places[0].startswith("/study.toml:5: study.replicatons: is not a known key; did you")
    assert "'replications'" in places[0]
    assert places[1].startswith("/study.toml:6: study.seed: -1 is too small")
    assert places[2].startswith("/study.toml:8: kpi.columns[1]: 'handover' is no key figure; did")
    assert "'handovers'" in places[2]
    assert len(lines) == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[factors]\n"plan.horizn" = [20]\n', "study.toml:6: factors.plan.horizn[0]: is not a kno"),
        ('[factors]\n"plan.horizon" = [20, "x"]\n', 'factors.plan.horizon[1]: "x" is not a whole'),
        ('[factors]\n"plan.horizn" = [20, 30]\n', "plan.horizn[0]: is not a known key; did"),
        ('[factors]\n"plan.horizon" = []\n', "factors.plan.horizon: has no levels"),
        ('[factors]\n"plan.horizon" = 3\n', "must be a list of values"),
        ('[factors]\n"planner.metod" = ["auto"]\n', "did you mean 'method'"),
        ('[factors]\n"planner.method" = ["magic"]\n', '"magic" must be one of auto, exact'),
        ('[factors]\n"ap.lft.enabled" = [true]\n', "no ap has the id 'lft'; did you mean 'left'"),
        ('[set]\n"radio.ap_capacity" = -3\n', "set.radio.ap_capacity: -3 is too small"),
        ('[[scenario]]\nname = "a"\n[[scenario]]\nname = "a"\n', "'a' is the name of scenario[0]"),
        ('[[scenario]]\nname = "a"\nset = {"plan.horizn" = 3}\n', "scenario[0].set.plan.horizn"),
        ('[log]\nmcap = "sometimes"\n', "must be one of all, failed, first, none"),
        ('[kpi]\ncolumns = ["ap_price.lft"]\n', "no ap has the id 'lft'; did you mean 'left'"),
        ('[kpi]\ncolumns = ["ap_price."]\n', "write the id of an access point"),
        ('[kpi]\ncommon = {methd = ["a"]}\n', "'methd' is no factor of this study"),
        ('[[figure]]\ntitle = "t"\nkpi = "cost"\nx = "nothing"\n', "'nothing' is no factor"),
        ('[[reference]]\ntext = "t"\nkpi = "cots"\n', "'cots' is no key figure; did you mean"),
        ("[factors]\nkind = {a = 3}\n", "is a named level and must be a table of values"),
        ('[quick]\nscenarios = ["b"]\n', "'b' is no scenario of this study"),
    ],
)
def test_a_mistake_is_named_and_a_remedy_given(folder, text, said):
    """Each kind of mistake in a study file ends in one sentence that says what to do."""
    (line,) = refused(folder, HEAD + text)
    assert "study.toml:" in line
    assert said in line, line


def test_baseline_must_exist(folder):
    """A baseline that no scenario has is refused, with the names there are."""
    (line,) = refused(folder, HEAD + 'baseline = "bse"\n[[scenario]]\nname = "moved"\n')
    assert "study.toml:5: study.baseline: 'bse' is no scenario of this study; did you" in line


def test_a_broken_world_is_told_with_its_own_line(folder):
    """Faults of the world file keep its file and line, behind the line that names it."""
    (folder / "hall.toml").write_text(HALL.replace("horizon = 20", "horizon = 0"))
    (line,) = refused(folder, HEAD)
    assert "study.toml:3: study.world:" in line
    assert "hall.toml:37: plan.horizon: 0 is too small" in line
    (folder / "hall.toml").unlink()
    (line,) = refused(folder, HEAD)
    assert "there is no such file" in line


def test_a_value_wrong_in_some_combinations_only_breaks_those(folder):
    """A fine grid is right in a small hall and a large hall with a coarse grid is: only their
    combination has too many positions. It breaks that cell, not the study; a value that is wrong
    in every combination is refused.
    """
    text = (
        '[factors]\n"hall.pitch_m" = [2.0, 0.01]\n"hall.size_m" = [[12.0, 8.0], [500.0, 500.0]]\n'
    )
    grid = planned(folder, HEAD + text)
    assert [bool(cell.error) for cell in grid.cells] == [False, False, False, True]
    assert "more than 1000000" in grid.cells[3].error
    (line,) = refused(folder, HEAD + text.replace("[12.0, 8.0]", "[400.0, 400.0]"))
    assert "study.toml:6: factors.hall.pitch_m[1]:" in line


def test_grid_is_every_scenario_with_every_combination(folder):
    """Two scenarios, 2 x 3 levels: 12 cells, each with all its levels."""
    grid = planned(
        folder,
        HEAD
        + '[[scenario]]\nname = "base"\n[[scenario]]\nname = "moved"\n'
        + 'set = {"ap.right.position_m" = [9.0, 7.0, 3.0]}\n'
        + '[factors]\n"plan.horizon" = [20, 30]\n"plan.objective" = ["hp", "tp", "snr"]\n',
    )
    assert len({cell.key for cell in grid.cells}) == 12
    assert grid.factors == ("plan.horizon", "plan.objective")
    world = parse_world(grid.cells[-1].world)
    assert (world.plan.horizon, world.plan.objective) == (30, "snr")
    assert world.ap[1].position_m == (9.0, 7.0, 3.0)


def test_scenarios_may_have_levels_of_their_own(folder):
    """A scenario's factors replace the study's; where a factor is missing, the world's value is
    the level, so that cells of all scenarios can be told by it.
    """
    grid = planned(
        folder,
        HEAD
        + '[factors]\n"plan.objective" = ["hp", "tp"]\n'
        + '[[scenario]]\nname = "a"\nfactors = {"plan.horizon" = [20, 40]}\n'
        + '[[scenario]]\nname = "b"\nset = {"plan.objective" = "snr"}\n',
    )
    levels = [
        (c.scenario, c.levels["plan.objective"], c.levels["plan.horizon"]) for c in grid.cells
    ]
    assert levels == [
        ("a", "hp", "20"),
        ("a", "hp", "40"),
        ("a", "tp", "20"),
        ("a", "tp", "40"),
        ("b", "snr", "20"),
    ]


def test_named_levels_set_several_values(folder):
    """A table of named levels is a factor whose levels set planner and world together."""
    grid = planned(
        folder,
        HEAD
        + '[factors.way]\nfast = {"planner.method" = "cooperative", "plan.horizon" = 25}\n'
        + 'sure = {"planner.method" = "exact"}\n',
    )
    fast, sure = grid.cells
    assert (fast.levels, sure.levels) == ({"way": "fast"}, {"way": "sure"})
    assert (fast.planner.method, sure.planner.method) == ("cooperative", "exact")
    assert parse_world(fast.world).plan.horizon == 25
    assert fast.matches({"way": "fast"})
    assert not fast.matches({"way": "sure"})


def test_all_cells_of_a_replication_have_the_same_seeds(folder):
    """Common random numbers: every seed of the world, the same for all cells, another for each
    replication; a seed that a study sets itself stays.
    """
    text = HEAD.replace("hall.toml", "drawn.toml") + "replications = 3\nseed = 7\n"
    grid = planned(folder, text + '[factors]\n"robots.random.count" = [2, 4]\n')
    seeds = {(run.replication, run.seed) for run in grid.runs}
    assert seeds == {(0, 7), (1, 8), (2, 9)}
    expected = set(seed_overrides(parse_world(DRAWN), 0))
    assert all(set(cell.seeds) == expected for cell in grid.cells)
    assert "robots.random.seed" in expected
    fixed = planned(folder, text + '[set]\n"robots.random.seed" = 5\n')
    assert set(fixed.cells[0].seeds) == expected - {"robots.random.seed"}
    assert parse_world(fixed.cells[0].world).robots.random.seed == 5


def test_a_scenario_changes_nothing_of_another(folder):
    """A list set for all runs, an element of it changed in each scenario: never in two at once."""
    aps = '[set]\nap = [{id = "a", position_m = [1.0, 4.0, 3.5]}, '
    aps += '{id = "b", position_m = [11.0, 7.0, 3.5]}]\n"radio.ap_capacity" = 5\n'
    more = [f'[[scenario]]\nname = "{ap}"\nset = {{"ap.{ap}.capacity" = 6}}\n' for ap in "ab"]
    grid = planned(folder, HEAD + aps + "".join(more) + '[[scenario]]\nname = "none"\n')
    found = [[ap.capacity for ap in parse_world(cell.world).ap] for cell in grid.cells]
    assert found == [[6, None], [None, 6], [None, None]]


def test_runs_are_ordered_by_replication(folder):
    """All cells of a replication stand together, so radio maps are met again."""
    grid = planned(folder, HEAD + 'replications = 2\n[factors]\n"plan.horizon" = [20, 30]\n')
    assert [(run.replication, run.cell) for run in grid.runs] == [(0, 0), (0, 1), (1, 0), (1, 1)]


def test_run_ids_change_with_what_decides_a_result_and_with_nothing_else(folder, monkeypatch):
    """Comments, key figures and more replications keep ids; values, seeds, planner, version do
    not.
    """
    text = HEAD + 'replications = 2\nseed = 3\n[factors]\n"plan.horizon" = [20, 30]\n'
    ids = [run.id for run in planned(folder, text).runs]
    assert len(set(ids)) == 4
    same = (
        text.replace("replications = 2", "replications = 3 # more") + '[kpi]\ncolumns = ["cost"]\n'
    )
    assert [run.id for run in planned(folder, same).runs][:4] == ids
    assert [run.id for run in planned(folder, text, replications=1).runs] == ids[:2]
    for other in (
        text.replace("seed = 3", "seed = 5"),
        text + "[planner]\niterations = 10\n",
        text + '[set]\n"radio.noise_dbm" = -81.0\n',
        text.replace('run = "plan"', 'run = "execute"'),
    ):
        assert set(ids).isdisjoint(run.id for run in planned(folder, other).runs)
    monkeypatch.setattr("twin.study.version", lambda: "9.9.9")
    assert set(ids).isdisjoint(run.id for run in planned(folder, text).runs)


def test_baselines(folder):
    """A scenario compares cells of equal levels, a table replaces levels, "base" without such a
    scenario is the world as it stands.
    """
    two = '[[scenario]]\nname = "now"\n[[scenario]]\nname = "then"\n'
    horizons = '[factors]\n"plan.horizon" = [20, 30]\n'
    grid = planned(folder, HEAD + 'baseline = "now"\n' + two + horizons)
    assert [cell.baseline for cell in grid.cells] == [None, None, 0, 1]
    grid = planned(folder, HEAD + 'baseline = {"plan.horizon" = 30}\n' + two + horizons)
    assert [cell.baseline for cell in grid.cells] == [1, None, 3, None]
    grid = planned(folder, HEAD + 'baseline = "base"\n' + horizons)
    assert [(c.scenario, c.baseline) for c in grid.cells] == [
        ("base", None),
        ("varied", 0),
        ("varied", 0),
    ]


def test_quick_is_shorter_and_nothing_else(folder):
    """`--quick` replaces replications, levels and scenarios; its runs are runs of the study."""
    text = (
        HEAD
        + 'replications = 5\nbaseline = "a"\n[[scenario]]\nname = "a"\n[[scenario]]\nname = "b"\n'
        + '[[scenario]]\nname = "c"\n[factors]\n"plan.horizon" = [20, 30, 40]\n'
        + '[factors.way]\nx = {"planner.restarts" = 1}\ny = {"planner.restarts" = 2}\n'
        + '[quick]\nreplications = 2\nscenarios = ["b"]\n'
        + '[quick.factors]\n"plan.horizon" = [30]\nway = ["y"]\n'
    )
    full, quick = planned(folder, text), planned(folder, text, quick=True)
    assert [cell.key for cell in quick.cells] == [("a", "30", "y"), ("b", "30", "y")]
    assert {run.id for run in quick.runs} < {run.id for run in full.runs}


@pytest.mark.parametrize(
    "path", sorted((Path(__file__).parents[2] / "studies").glob("*.toml")), ids=lambda p: p.stem
)
def test_studies_that_ship_can_be_run(path, tmp_path):
    """Every shipped study expands without a fault and has a short form; it explains itself."""
    for quick in (False, True):
        grid = plan_study(path, quick=quick, replications=1)
        assert [cell.error for cell in grid.cells] == [""] * len(grid.cells)
    assert grid.study.study.story
    assert len(grid.runs) < len(plan_study(path).runs)
    assert "twin study" in path.read_text()


def test_a_big_grid_expands_in_time(folder):
    """A thousand cells are checked and named within seconds."""
    horizons = ", ".join(str(h) for h in range(20, 1020))
    begin = time.process_time()
    grid = planned(folder, HEAD + f'[factors]\n"plan.horizon" = [{horizons}]\n')
    assert len(grid.runs) == 1000
    assert time.process_time() - begin < 20
    shutil.rmtree(folder, ignore_errors=True)
