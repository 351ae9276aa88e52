"""The picture of a run: lines where the robots drove, in the colour of the AP that served them."""

from __future__ import annotations

import numpy as np
import pytest

from logs.figures import LANES_SHARE, Trace, draw_run, handover_places, lane_m, run_figure, strokes
from logs.mcap_reader import read
from logs.records import Handover
from tests.cli_tools import good_run
from tests.logs.good_logs import log_of
from worlds.errors import WorldError

__all__ = ["good_run"]  # fixture


def trace(*places: tuple[float, float, int]) -> Trace:
    """A trace through (x, y, AP)."""
    return Trace([(x, y) for x, y, _ in places], [ap for *_, ap in places], [False] * len(places))


def handover(x: float, y: float) -> Handover:
    """A handover there."""
    return Handover(0.0, 0, "r", "a", "b", 0, 0, x, y, 0.07, True)


def test_a_straight_drive_is_one_line():
    """Places on a straight line are left out."""
    ((ap, line),) = strokes(trace(*((float(x), 0.0, 2) for x in range(9))))
    assert ap == 2
    assert line.tolist() == [[0, 0], [8, 0]]


def test_corners_and_turns_back_are_kept():
    """Where a robot turns, also by half a turn, the line has a corner."""
    ((_, line),) = strokes(trace((0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 0)))
    assert line.tolist() == [[0, 0], [2, 0], [1, 0], [1, 1]]


def test_lines_change_colour_at_the_handover_without_a_gap():
    """A piece begins where the one before it ends."""
    pieces = strokes(trace((0, 0, 0), (1, 0, 0), (2, 0, 1), (3, 0, 1), (4, 0, 0)))
    assert [ap for ap, _ in pieces] == [0, 1, 0]
    assert [line.tolist() for _, line in pieces] == [
        [[0, 0], [1, 0]],
        [[1, 0], [3, 0]],
        [[3, 0], [4, 0]],
    ]


@pytest.mark.parametrize("samples", [1, 2, 5])
def test_a_robot_that_stands_has_no_line(samples):
    """A robot at its goal from the beginning is a mark, not a line."""
    assert all(len(line) == 1 for _, line in strokes(trace(*[(1.0, 1.0, 0)] * samples)))


def test_lanes_lie_within_their_share_of_the_pitch_and_apart():
    """Robots in one aisle are drawn beside each other."""
    lanes = [lane_m(robot, 2.0) for robot in range(40)]
    assert max(map(abs, lanes)) <= 2.0 * LANES_SHARE
    assert len(set(lanes)) == 40


def test_near_handovers_are_one_place():
    """Marks nearer than half a pitch are one mark with a number."""
    places = handover_places([handover(0, 0), handover(0.4, 0), handover(5, 0)], 2.0)
    assert [(round(x, 6), y, n) for x, y, n in places] == [(0.2, 0, 2), (5, 0, 1)]
    assert handover_places([], 2.0) == []


def test_picture_tells_aps_handovers_and_coverage_in_words(good_run):
    """Each AP, the handovers and the coverage have their line in the legend; axes are in metres."""
    figure = run_figure(read(good_run[0] / "run.mcap"))
    words = " | ".join(text.get_text() for text in figure.axes[0].get_legend().get_texts())
    for part in ("served by left", "served by right", "handover", "goal", "covered by 2 APs"):
        assert part in words
    (ax,) = figure.axes
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "y [m]")
    plan = good_run[1].json["plan"]
    assert f"plan cost {plan['cost']}" in ax.get_title(loc="left")


def test_picture_of_the_same_log_has_the_same_bytes(good_run, tmp_path):
    """Nothing but the log enters the picture (§1.15)."""
    log = good_run[0] / "run.mcap"
    draw_run(read(log), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes() == (good_run[0] / "hall.png").read_bytes()


def test_paths_lie_where_the_samples_are(good_run):
    """Every corner of a line, its lane taken off, is a sampled place."""
    run = read(good_run[0] / "run.mcap")
    xy = run.problem.xy_m
    for robot, path in enumerate(run.plan.paths):
        drawn = Trace([tuple(xy[v]) for v in path.vertices], path.aps.tolist(), [])
        for _, line in strokes(drawn):
            assert all((np.abs(xy - corner).sum(axis=1) < 1e-9).any() for corner in line), robot


def test_other_kinds_of_files_are_refused(good_run, tmp_path):
    """A picture is .png or .svg."""
    with pytest.raises(WorldError, match="png"):
        draw_run(read(good_run[0] / "run.mcap"), tmp_path / "hall.bmp")


CORRIDOR = """
name = "the corridor between the halls of the old works"
[hall]
size_m = [WIDTH, DEPTH]
pitch_m = 2.0
[[ap]]
id = "entrance"
position_m = [2.0, 2.0, 3.0]
[radio]
tx_power_dbm = 10.0
[robots.random]
count = 3
[plan]
horizon = 60
"""


@pytest.mark.parametrize(("width", "depth"), [("4.0", "40.0"), ("40.0", "4.0"), ("12.0", "12.0")])
def test_nothing_is_cut_and_no_words_run_into_others(width, depth):
    """Title, labels and legend lie within the picture, the legend beside the hall, not on it."""
    world = CORRIDOR.replace("WIDTH", width).replace("DEPTH", depth)
    figure = run_figure(read(log_of(world=world)))
    figure.canvas.draw()
    (ax,) = figure.axes
    title = next(text for text in [*ax.texts, ax._left_title] if "corridor" in text.get_text())
    words = [title, ax.xaxis.label, ax.yaxis.label, ax.get_legend()]
    extents = [piece.get_window_extent() for piece in words]
    for extent in extents:
        assert extent.x0 >= 0
        assert extent.y0 >= 0
        assert extent.x1 <= figure.bbox.x1
        assert extent.y1 <= figure.bbox.y1
    legend, hall = extents[-1], ax.get_window_extent()
    assert not any(legend.overlaps(other) for other in [*extents[:-1], hall])
