"""Pictures of halls: drawn to scale, labelled, complete, and the same each time."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch

from tests.worlds.floors import ap, boxes, grid_floor, world
from tests.worlds.radio_maps import FOUR, paper_floor, tiny
from worlds.errors import WorldError
from worlds.figures import draw_coverage, draw_hall, footprints_m, save, snr_norm
from worlds.radio_figure import radio_figure
from worlds.radio_map import build_radio_map


def panels(figure: Figure) -> list[Axes]:
    """The hall panels of a figure: no colour bars, no empty places, not the distribution."""
    return [ax for ax in figure.axes if ax.get_title() and "distribution" not in ax.get_title()]


@pytest.fixture(scope="module")
def paper() -> Figure:
    """The paper's hall with fading."""
    floor, hall = paper_floor(1), world(FOUR, shadow_fading=True)
    return radio_figure(hall, floor, build_radio_map(hall, floor))


def test_each_ap_the_best_and_the_count_have_a_panel(paper: Figure) -> None:
    """Four APs make eight panels, in metres, to scale, over the whole hall, and a distribution."""
    titles = [ax.get_title() for ax in panels(paper)]
    assert [title.split(" covers")[0] for title in titles[:4]] == ["ap0", "ap1", "ap2", "ap3"]
    assert titles[4].startswith("best AP: ")
    assert titles[5:7] == ["second-best AP", "the AP of highest SNR"]
    assert titles[7].endswith("covered by two APs or more")
    assert len(titles) == 8
    assert [ax.get_title() for ax in paper.axes if "distribution" in ax.get_title()]
    for ax in panels(paper):
        assert ax.get_aspect() == 1.0
        for low, high in (ax.get_xlim(), ax.get_ylim()):
            assert low <= 0
            assert high >= 60
    assert {ax.get_xlabel() for ax in panels(paper)[-3:]} == {"x [m]"}
    assert panels(paper)[0].get_ylabel() == "y [m]"


def test_colour_bars_name_what_they_show_and_its_unit(paper: Figure) -> None:
    """SNR in dB, and the number of APs."""
    bars = {ax.get_ylabel() for ax in paper.axes if not ax.get_title() and ax.get_ylabel()}
    assert any("SNR [dB]" in label for label in bars)
    assert any("APs that cover" in label for label in bars)


def test_cells_show_the_snr_of_their_vertex_and_holes_are_hatched() -> None:
    """A colour per vertex, where the vertex is; blocked positions have none; holes are hatched."""
    floor = grid_floor(3, 2, 2.0, blocked=[(1, 0)], origin_m=(1.0, 1.0))
    radio_map, _ = tiny([[[0.0], [0.0]]] * 4, vertex_snr_db=[[20.0], [5.0], [30.0], [12.0], [9.0]])
    ax = Figure().subplots()
    mesh = draw_coverage(ax, floor, radio_map, ap=0)
    assert isinstance(mesh, QuadMesh)
    cells = np.ma.getdata(mesh.get_array())
    np.testing.assert_array_equal(np.ma.getmaskarray(mesh.get_array())[0], [False, True, False])
    np.testing.assert_array_equal(cells[0, [0, 2]], [20.0, 5.0])
    np.testing.assert_array_equal(cells[1], [30.0, 12.0, 9.0])
    np.testing.assert_allclose(mesh.get_coordinates()[0, 0], [0.0, 0.0])
    np.testing.assert_allclose(mesh.get_coordinates()[-1, -1], [6.0, 4.0])
    (hatched,) = [patch for patch in ax.patches if isinstance(patch, PathPatch)]
    assert hatched.get_hatch()
    path = hatched.get_path()
    inside = [path.contains_point(p) for p in [(1, 1), (5, 1), (1, 3), (3, 3), (5, 3)]]
    assert inside == [False, True, False, False, True]


def test_obstacles_are_drawn_where_and_as_they_stand() -> None:
    """A box turned by 90° swaps its sides; all boxes are in the picture."""
    standing = boxes([(5, 4, 1), (9, 4, 1)], (2.0, 1.0, 1.0), [np.pi / 2, 0.0])
    corners = footprints_m(standing)
    np.testing.assert_allclose(corners[0].min(axis=0), [4, 2])
    np.testing.assert_allclose(corners[0].max(axis=0), [6, 6])
    np.testing.assert_allclose(corners[1].max(axis=0), [11, 5])
    ax = Figure().subplots()
    draw_hall(ax, world([ap("a", 1, 1)], (12, 8)), grid_floor(2, 2, standing=standing))
    (drawn,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
    assert len(drawn.get_paths()) == 2


def test_every_ap_has_its_label_and_those_switched_off_say_so() -> None:
    """Markers at the APs' places, ids beside them."""
    ax = Figure().subplots()
    hall = world([ap("north", 3, 50), ap("south", 58, 2, enabled=False)])
    draw_hall(ax, hall, grid_floor(2, 2))
    assert {text.get_text() for text in ax.texts} == {"north", "south (off)"}
    assert sorted(tuple(line.get_xydata()[0]) for line in ax.lines) == [(3, 50), (58, 2)]


def test_of_many_aps_those_that_cover_least_are_shown_and_said_so() -> None:
    """Nine APs: six panels, the weak one among them, and the title tells."""
    aps = [ap(f"ap{i}", 5.0 + 6 * i, 30, tx_power_dbm=-40.0 if i == 8 else 24.0) for i in range(9)]
    floor, hall = paper_floor(2), world(aps)
    figure = radio_figure(hall, floor, build_radio_map(hall, floor))
    assert len(panels(figure)) == 10
    assert any(ax.get_title().startswith("ap8 covers") for ax in panels(figure))
    assert "the 6 of 9 APs that cover least" in figure.get_suptitle()


def test_threshold_is_always_within_the_colours() -> None:
    """Also where everything, or nothing, is covered."""
    for snr in (80.0, -80.0):
        radio_map, _ = tiny([[[snr], [snr]]])
        norm = snr_norm(radio_map)
        assert norm.vmin < radio_map.threshold_db < norm.vmax


@pytest.mark.parametrize("blocked", [[], [(0, 0), (1, 0), (0, 1), (1, 1)]])
def test_halls_without_aps_or_floor_are_drawn_too(blocked, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """Nothing to show is no error."""
    floor, hall = grid_floor(2, 2, blocked=blocked), world([ap("a", 1, 1, enabled=False)])
    save(radio_figure(hall, floor, build_radio_map(hall, floor)), tmp_path / "empty.png")


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_the_same_figure_gives_the_same_bytes(suffix: str, tmp_path: Path) -> None:
    """No date, no version, no random ids; and nothing of the user's settings is changed."""
    floor, hall = grid_floor(4, 3), world([ap("a", 1, 1)], (4, 3), noise_dbm=-40.0)
    radio_map = build_radio_map(hall, floor)
    settings = dict(mpl.rcParams)
    written = []
    for name in ("one", "two"):
        path = tmp_path / (name + suffix)
        save(radio_figure(hall, floor, radio_map), path)
        written.append(path.read_bytes())
    assert written[0] == written[1]
    assert dict(mpl.rcParams) == settings
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one" + suffix, "two" + suffix]


def test_a_file_that_cannot_be_written_is_told(paper: Figure, tmp_path: Path) -> None:
    """Another ending, or a folder that is not there: a message, no traceback, no rest."""
    with pytest.raises(WorldError, match=r"ends in '\.bmp'; pictures are \.png or \.svg"):
        save(paper, tmp_path / "hall.bmp")
    with pytest.raises(WorldError, match=r"hall\.png cannot be written: No such file"):
        save(paper, tmp_path / "nowhere" / "hall.png")
    assert not list(tmp_path.iterdir())
