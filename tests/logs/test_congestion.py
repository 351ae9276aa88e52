"""The prices as a picture and as a Foxglove topic."""

from __future__ import annotations

import dataclasses
import struct

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PathCollection

from logs.congestion import MAX_PANELS, congestion_figure, draw_congestion
from logs.foxglove import CONGESTION_HEIGHT_M, NO_POSITION_PRICE, congestion_grid
from logs.foxglove_view import AP_COVERAGE, TOPICS, View
from logs.layout import build_layout
from logs.mcap_reader import read
from logs.mcap_writer import RunLog
from planner.plan import Plan
from planner.prices import Prices
from tests.logs.sample_run import SampleRun, sample_run
from worlds.errors import WorldError
from worlds.radio_map import kept_vertices


def priced(run: SampleRun, *, aps: tuple[float, ...] = (0.0, 6.0), c_t: int = 1) -> Plan:
    """The run's plan with prices: vertex 3 costs 4, edge 2 costs 2, and the APs as given."""
    problem = run.problem
    vertex, edge = np.zeros(problem.n_vertices), np.zeros(problem.n_edges)
    vertex[3], edge[2] = 4.0, 2.0
    by_slot = np.zeros((problem.horizon + 1, problem.n_aps))
    by_slot[2:4] = np.array(aps) / 2
    advice = "AP ap1's capacity costs 6 slots; a handover counts as 10 slots"
    return dataclasses.replace(
        run.plan, prices=Prices(vertex, edge, by_slot, run.plan.cost - 2.5, c_t, advice)
    )


@pytest.fixture(scope="module")
def run() -> SampleRun:
    """A run of ten slots."""
    return sample_run(10)


def texts(figure) -> list[str]:
    """All that is written in a figure."""
    words = [t.get_text() for ax in figure.axes for t in (*ax.texts, ax.title)]
    words += [ax.get_title(loc="left") for ax in figure.axes]
    words += [ax.get_ylabel() for ax in figure.axes]
    words += [t.get_text() for legend in figure.legends for t in legend.get_texts()]
    return words


def test_picture_shows_priced_positions_ways_and_aps(run):
    """One mark per priced position and way, where it is in metres; every AP with its price."""
    figure = congestion_figure(run.problem, priced(run), (run.world, run.floor))
    hall = figure.axes[0]
    (positions,) = [c for c in hall.collections if isinstance(c, PathCollection)]
    assert positions.get_offsets().tolist() == [run.problem.xy_m[3].tolist()]
    ways = [c.get_segments() for c in hall.collections if isinstance(c, LineCollection)]
    drawn = [np.asarray(segment).tolist() for segments in ways for segment in segments]
    way = run.problem.xy_m[run.problem.edge_uv[2]].tolist()
    assert drawn.count(way) == 2  # once as a way of the graph, once with its price
    assert (hall.get_xlabel(), hall.get_ylabel()) == ("x [m]", "y [m]")
    written = texts(figure)
    assert {"ap0: 0", "ap1: 6", "4"} <= set(written)
    assert any("AP ap1's capacity costs 6 slots" in text for text in written)
    assert {"AP with a price [slots]", "AP without a price", "way with a price"} <= set(written)


def test_picture_tells_what_the_prices_prove(run):
    """The bound in the title is that of the prices, rounded up as costs are integers."""
    (title,) = [t for t in texts(congestion_figure(run.problem, priced(run))) if "prove" in t]
    assert f"no plan costs less than {run.plan.cost - 2}" in title


def test_prices_of_aps_over_time_have_a_panel_each(run):
    """Only APs with a price; slots in which they have one; one scale for all."""
    plan = priced(run, aps=(2.0, 6.0))
    figure = congestion_figure(run.problem, plan, (run.world, run.floor))
    panels = [ax for ax in figure.axes if ax.get_xlabel() == "slot"]
    assert [ax.get_title() for ax in panels] == ["ap0 (m = 3)", "ap1 (m = 3)"]
    assert len({ax.get_ylim() for ax in panels}) == 1
    assert panels[0].get_ylim()[1] >= 3.0
    values, edges, _ = panels[1].patches[0].get_data()
    assert values[2:4].tolist() == [3.0, 3.0]
    assert edges[2] == 1.5
    assert values.sum() == 6.0
    only = congestion_figure(run.problem, priced(run))
    assert [ax.get_title() for ax in only.axes if ax.get_xlabel() == "slot"] == ["ap1 (m = 3)"]


def test_picture_without_any_price_is_drawn(run):
    """No shortage: the floor, no panel, no colour bar, no error."""
    nothing = Prices(
        np.zeros(run.problem.n_vertices), np.zeros(run.problem.n_edges), np.zeros((11, 2)), 3.0, 1
    )
    plan = dataclasses.replace(run.plan, prices=nothing)
    assert len(congestion_figure(run.problem, plan).axes) == 1
    with pytest.raises(ValueError, match="no prices"):
        congestion_figure(run.problem, run.plan)


def test_many_aps_get_panels_up_to_a_limit(run):
    """Of more APs than there is room for the dearest are shown."""
    n = MAX_PANELS + 3
    problem = dataclasses.replace(
        run.problem,
        ap_ids=tuple(f"ap{k}" for k in range(n)),
        ap_capacity=np.full(n, 3),
        cover=np.ones((run.problem.n_vertices, n), bool),
        snr_db=np.full((run.problem.n_vertices, n), np.nan),
        edge_cover=np.ones((run.problem.n_edges, n), bool),
        edge_handover=np.broadcast_to(~np.eye(n, dtype=bool), (run.problem.n_edges, n, n)),
    )
    by_slot = np.tile(np.arange(n, dtype=float), (11, 1))
    prices = Prices(np.zeros(problem.n_vertices), np.zeros(problem.n_edges), by_slot, 1.0, 1)
    figure = congestion_figure(problem, dataclasses.replace(run.plan, prices=prices))
    panels = [ax.get_title() for ax in figure.axes if ax.get_xlabel() == "slot"]
    assert panels == [f"ap{k} (m = 3)" for k in range(3, n)]


def test_files_are_written_whole_and_alike(run, tmp_path):
    """§1.15: same plan, same bytes; another ending is refused."""
    for name in ("a.png", "b.png", "a.svg"):
        draw_congestion(tmp_path / name, run.problem, priced(run), (run.world, run.floor))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "a.svg", "b.png"]
    with pytest.raises(WorldError, match=r"\.pdf"):
        draw_congestion(tmp_path / "a.pdf", run.problem, priced(run))


def test_grid_holds_the_price_at_every_position(run):
    """A cell per position: its own price and half of its ways'; -1 where no robot can stand."""
    prices = priced(run).prices
    grid = congestion_grid(run.floor, run.radio_map, run.problem, prices)
    rows, columns = run.floor.rows, run.floor.columns
    cells = np.array(struct.unpack(f"<{rows * columns}f", grid.data)).reshape(rows, columns)
    free = np.full((rows, columns), NO_POSITION_PRICE)
    around = prices.around(run.problem.edge_uv)
    for k, v in enumerate(kept_vertices(run.radio_map)):
        column, row = run.floor.vertex_cell[v]
        free[row, column] = around[k]
    assert np.allclose(cells, free)
    assert cells[cells > 0].sum() == pytest.approx(6.0)
    assert (grid.fields[0].name, grid.column_count) == ("price", columns)
    assert grid.pose.position.z == CONGESTION_HEIGHT_M
    assert grid.pose.orientation.w == 1


def test_topic_is_there_only_with_prices(run, tmp_path):
    """`/radio/congestion` is a channel, repeated as statics are, when the plan has prices."""
    inputs = run.inputs
    assert "/radio/congestion" not in View(**inputs).topics
    topics = View(**{**inputs, "plan": priced(run)}).topics
    assert {topic for topic in topics if not topic.startswith("/aps/")} == set(TOPICS) - {
        AP_COVERAGE
    }
    for name, plan in (("without", run.plan), ("with", priced(run))):
        path = tmp_path / f"{name}.mcap"
        with RunLog(path, **{**inputs, "plan": plan}) as log:
            for record in run.records:
                log.write(record)
        found = [m for m in read(path).iter_messages() if m.topic == "/radio/congestion"]
        assert len(found) == (name == "with")
        assert read(path).plan.prices == plan.prices
        assert ("/radio/congestion" in (tmp_path / f"{name}.layout.json").read_text()) == bool(
            found
        )


def test_layout_colours_begin_at_nothing(run):
    """Price 0 is invisible, so that the coverage below stays readable."""
    plan = priced(run)
    settings = build_layout(run.world, run.problem, run.radio_map, plan.prices)["configById"]
    topic = settings["3D!hall"]["topics"]["/radio/congestion"]
    assert topic["visible"]
    assert topic["gradient"][0].endswith("00")
    assert (topic["minValue"], topic["colorField"]) == (0, "price")
    assert topic["maxValue"] == plan.prices.around(run.problem.edge_uv).max()


def test_prices_in_cost_units_where_a_slot_is_free(run):
    """c_t = 0: there are no slots to count in."""
    plan = priced(run, c_t=0)
    assert plan.prices.unit == "cost units"
    assert any("[cost units]" in t for t in texts(congestion_figure(run.problem, plan)))
