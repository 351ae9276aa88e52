"""The pipeline as a library: what it says of a plan, hints, and files that appear all together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner.plan import Path, Plan
from tests.cli_tools import hall
from twin import pipeline
from twin.errors import TwinError
from twin.instance import Stopwatch, open_instance, seed_overrides
from twin.outputs import check_writable, staged, write_text
from twin.pipeline import crossings_with_holes, describe_plan, hints, make_plan, per_cent_at_most

__all__ = ["hall"]  # fixture


def plan(status: str, cost: int, bound: float | None, served: bool = True) -> Plan:
    """A plan of one robot."""
    path = Path("r0", *(np.zeros(n, np.int32) for n in (1, 1, 0)))
    return Plan(status, ("r0",), (path if served else None,), cost, bound)


def test_words_promise_no_more_than_is_proven():
    """§1.13: a gap is rounded up, and a plan without a bound claims none."""
    assert per_cent_at_most(0.0120) == "1.2 %"
    assert per_cent_at_most(0.01201) == "1.3 %"
    assert describe_plan(plan("feasible", 1001, 1000)) == (
        "plan cost 1001, proven within 0.1 % of optimal"
    )
    assert describe_plan(plan("feasible", 5, None)) == "plan cost 5, no bound proven"
    assert describe_plan(plan("optimal", 5, 5)) == "plan cost 5, proven optimal"


def test_words_name_the_robots_without_a_path():
    """§1.12: infeasible and unknown are told apart, and both name robots."""
    infeasible = replace(plan("infeasible", 0, None, served=False), infeasible_robots=("r0",))
    assert describe_plan(infeasible).startswith("proven: no plan exists")
    unknown = describe_plan(plan("unknown", 0, 0, served=False))
    assert "no proof" in unknown
    for words in (describe_plan(infeasible), unknown):
        assert "r0" in words


def test_holes_between_the_ends_of_edges_are_counted(hall):
    """§1.7: a crossing hides a hole where some sample is reached by neither AP of its two ends."""
    made = open_instance(hall, overrides={"radio.edge_rule": "endpoints"})
    answer = make_plan(made.problem)
    crossings = sum(int((p.edges >= 0).sum()) for p in answer.paths)
    assert crossings_with_holes(made, answer) == (crossings, 0)
    assert hints(made, answer) == ()

    edge = int(answer.paths[0].edges[answer.paths[0].edges >= 0][0])
    used = sum(int((p.edges == edge).sum()) for p in answer.paths)
    snr = made.radio_map.edge_snr_db.copy()
    snr[edge, snr.shape[1] // 2] = -50.0  # every vertex and edge is covered here: same indices
    holed = replace(made, radio_map=replace(made.radio_map, edge_snr_db=snr))
    assert crossings_with_holes(holed, answer) == (crossings, used)
    assert "radio.edge_rule=samples" in hints(holed, answer)[0]


def test_seed_overrides_only_what_is_drawn(hall):
    """A world that lists its robots and obstacles has no seeds for them."""
    world = open_instance(hall).world
    assert set(seed_overrides(world, 3)) == {"radio.fading_seed", "plan.seed", "run.seed"}


def test_stopwatch_adds_up_and_tells():
    """Phases of one name are one entry; a listener hears each begin."""
    heard = []
    watch = Stopwatch(lambda text, share: heard.append((text, share)))
    for _ in range(2):
        with watch.phase("a"):
            watch.share("a")(1, 4)
    assert list(watch.seconds) == ["a"]
    assert heard == [("a", None), ("a", 0.25)] * 2


def test_staged_files_appear_together_or_not_at_all(tmp_path):
    """After a failure not even the folders that were made are left."""
    target = tmp_path / "a" / "b"

    def interrupted():
        with staged(target) as stage:
            (stage / "x").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []
    with staged(target) as stage:
        (stage / "x").write_text("whole")
        assert not (target / "x").exists()
    assert [p.name for p in target.iterdir()] == ["x"]


def test_write_text_replaces_a_file_as_a_whole(tmp_path):
    """The old content, or the new, and no file besides."""
    path = tmp_path / "x.json"
    path.write_text("old")
    write_text(path, "new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_writable_is_tried_and_not_guessed(tmp_path):
    """A place below a file, or in a file system that takes none, is refused; nothing is left."""
    check_writable(tmp_path / "not" / "yet" / "there")
    (tmp_path / "file").touch()
    for place in (tmp_path / "file" / "x", type(tmp_path)("/proc/x")):
        with pytest.raises(TwinError):
            check_writable(place)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_twin_that_stops_early_is_a_defect():
    """No key figures are made up for a run without an end."""
    with pytest.raises(RuntimeError, match="not ended"):
        pipeline.Tally().result()
