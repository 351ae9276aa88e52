"""Rays: `Scene.cast` against an exact slab test, and the traps of the engine below it."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.oracles import slab
from tests.worlds.floors import ap, boxes, grid_floor, random_boxes, world
from worlds import scene as scene_module
from worlds.floor import Boxes
from worlds.generate import resolve
from worlds.link import LinkModel
from worlds.scene import GROW_M, Scene, ray_growth_m
from worlds.world import World

Array = NDArray[np.float64]


def entries(standing: Boxes, start: Array, end: Array, grow_m: float = GROW_M) -> Array:
    """The oracle's answer for boxes grown as the scene grows them."""
    return slab.entries(standing.center_m, standing.half_m + grow_m, standing.yaw_rad, start, end)


def assert_exact(standing: Boxes, start: Array, end: Array) -> None:
    """Both ways, every ray is blocked if and only if the oracle says so, by a box it crosses."""
    enter = entries(standing, start, end)
    with Scene(standing) as scene:
        there, back = scene.cast(start, end), scene.cast(end, start)
    blocked = np.isfinite(enter).any(axis=1)
    np.testing.assert_array_equal(there >= 0, blocked)
    np.testing.assert_array_equal(back >= 0, blocked)
    for hit in (there, back):
        assert np.isfinite(enter[blocked, hit[blocked]]).all()


def random_ends(rng: np.random.Generator, rays: int, hall_m: float) -> tuple[Array, Array]:
    """Both ends of rays anywhere in a hall, up to 6 m high."""
    ends = rng.uniform(0, hall_m, (2, rays, 3))
    ends[..., 2] = rng.uniform(0.1, 6.0, (2, rays))
    return ends[0], ends[1]


@pytest.mark.parametrize("seed", range(6))
def test_random_rays_meet_exactly_the_boxes_they_cross(seed: int) -> None:
    """Equality with the oracle on random worlds, half of them yawed, ends inside boxes included."""
    rng = np.random.default_rng(seed)
    hall_m = (20.0, 60.0, 200.0)[seed % 3]
    standing = random_boxes(rng, 120, hall_m, yawed=seed % 2 == 0)
    assert_exact(standing, *random_ends(rng, 3000, hall_m))


@pytest.mark.parametrize("seed", range(4))
def test_rays_aimed_at_edges_meet_exactly_the_boxes_they_cross(seed: int) -> None:
    """Rays that pass an edge of a grown box within micrometres to centimetres are still exact."""
    rng = np.random.default_rng(100 + seed)
    standing = random_boxes(rng, 60, 60.0, yawed=seed % 2 == 0)
    start, _ = random_ends(rng, 4000, 60.0)
    box = rng.integers(0, len(standing), len(start))
    along = np.arange(3) == rng.integers(0, 3, len(start))[:, None]
    side = rng.choice([-1.0, 1.0], start.shape)
    local = np.where(along, rng.uniform(-1, 1, start.shape), side) * (standing.half_m[box] + GROW_M)
    miss = rng.normal(size=start.shape)
    miss *= 10 ** rng.uniform(-6, -2, (len(start), 1)) / np.linalg.norm(miss, axis=1)[:, None]
    x, y, z = (local + miss).T
    cos, sin = np.cos(standing.yaw_rad[box]), np.sin(standing.yaw_rad[box])
    through = standing.center_m[box] + np.column_stack((cos * x - sin * y, sin * x + cos * y, z))
    end = through + (through - start) * rng.uniform(0.05, 1.0, (len(start), 1))
    assert_exact(standing, start, end)


def test_on_an_aligned_grid_rays_along_faces_are_exact() -> None:
    """Boxes on a grid, APs over the grid's own lines: the rays that graze faces are blocked."""
    cells = np.argwhere(np.random.default_rng(5).random((20, 20)) < 0.3).astype(float)
    standing = boxes(np.column_stack((cells, np.ones(len(cells)))))
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    points = np.column_stack((x.ravel(), y.ravel(), np.full(400, 0.5)))
    aps = np.array([(4.5, 4.5, 5.0), (14.5, 4.5, 1.5), (4.5, 14.5, 2.0), (10.0, 10.0, 5.0)])
    start, end = np.repeat(aps, 400, axis=0), np.tile(points, (4, 1))
    exact = np.isfinite(entries(standing, start, end, 0.0)).any(axis=1)
    smaller = np.isfinite(entries(standing, start, end, -1e-6)).any(axis=1)
    assert (exact != smaller).mean() > 0.01, "this grid was to have rays along faces"
    assert_exact(standing, start, end)


lattice = st.integers(-6, 6).map(lambda n: n / 2)
point = st.tuples(lattice, lattice, st.sampled_from((0.0, 0.5, 1.0, 2.0, 5.0)))


@settings(max_examples=60, deadline=None)
@given(
    center=st.lists(point, min_size=1, max_size=4),
    yaw=st.sampled_from((0.0, np.pi / 4, np.pi / 2)),
    ends=st.lists(st.tuples(point, point), min_size=1, max_size=12),
)
def test_degenerate_rays_are_exact(
    center: list[tuple[float, float, float]],
    yaw: float,
    ends: list[tuple[tuple[float, float, float], tuple[float, float, float]]],
) -> None:
    """Boxes and rays on one lattice: corners, faces, ends in boxes, rays of no length."""
    start, end = np.array(ends).swapaxes(0, 1)
    assert_exact(boxes(center, yaw_rad=yaw), start, end)


def test_the_box_met_first_is_named() -> None:
    """Of boxes in a row the nearest to the start is reported, from either side."""
    row = boxes([(x, 0.0, 1.0) for x in (2.0, 4.0, 6.0, 8.0)])
    with Scene(row) as scene:
        np.testing.assert_array_equal(scene.cast([(0, 0, 1), (10, 0, 1)], (5, 0, 1)), [0, 3])


def test_first_box_of_random_rays_is_the_oracles() -> None:
    """The box reported is the one entered first, but for rays that graze a box by millimetres."""
    rng = np.random.default_rng(8)
    standing = random_boxes(rng, 150, 60.0)
    start, end = random_ends(rng, 4000, 60.0)
    enter = entries(standing, start, end)
    with Scene(standing) as scene:
        hit = scene.cast(start, end)
    met = np.flatnonzero(hit >= 0)
    first = enter[met, hit[met]] == enter[met].min(axis=1)
    assert first.mean() > 0.999


@pytest.mark.parametrize("rays", [16_000, 16_384, 20_000])
def test_no_ray_of_a_large_call_is_lost(rays: int) -> None:
    """Every ray is answered, though the engine drops some from 16 384 in one call."""
    standing = boxes([(5.0, 0.0, 1.0)])
    start = np.tile((0.0, 0.0, 0.5), (rays, 1))
    end = np.tile([(10.0, 0.0, 0.5), (10.0, 9.0, 0.5)], (rays // 2, 1))
    with Scene(standing) as scene:
        hit = scene.cast(start, end)
        assert scene.rays_cast == rays
        assert scene.seconds > 0
    np.testing.assert_array_equal(hit, np.tile([0, -1], rays // 2))


def test_a_lost_answer_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Should the engine answer fewer rays than asked, nobody takes that for line of sight."""
    with Scene(boxes([(5.0, 0.0, 1.0)])) as scene:
        engine = scene._pb

        class Forgetful:
            def __getattr__(self, name: str) -> object:
                return getattr(engine, name)

            def rayTestBatch(self, *args: object, **rest: object) -> object:  # noqa: N802
                return engine.rayTestBatch(*args, **rest)[:-1]

        monkeypatch.setattr(scene, "_pb", Forgetful())
        with pytest.raises(RuntimeError, match="1 of 2 rays"):
            scene.cast([(0, 0, 0.5)] * 2, (9, 0, 0.5))


def test_a_ray_that_starts_or_ends_in_a_box_is_blocked_by_it() -> None:
    """Containment counts as blocked, also for a ray of no length."""
    inside, outside, other = (5.0, 0.0, 1.0), (5.0, 3.0, 1.0), (5.2, 0.1, 1.2)
    with Scene(boxes([inside], yaw_rad=0.3)) as scene:
        ends = [(inside, outside), (outside, inside), (inside, other), (inside, inside)]
        start, end = np.array(ends).swapaxes(0, 1)
        np.testing.assert_array_equal(scene.cast(start, end), [0, 0, 0, 0])
        assert scene.cast(outside, [outside])[0] == -1


def test_boxes_that_touch_leave_no_gap() -> None:
    """A ray through the common edge of two boxes that touch at their corners is blocked."""
    corner_to_corner = boxes([(0.5, 0.5, 1.0), (1.5, 1.5, 1.0)])
    with Scene(corner_to_corner) as scene:
        assert scene.cast((0.0, 2.0, 1.0), [(2.0, 0.0, 1.0)])[0] >= 0


def test_boxes_grow_by_two_millimetres_and_the_clearance() -> None:
    """A ray 1 mm beside a box is blocked, 3 mm beside it free, unless a clearance is asked for."""
    floor = grid_floor(1, 1, standing=boxes([(5.0, 0.0, 1.0)]))
    ends = [((0, y, 1.0), (10, y, 1.0)) for y in (0.501, 0.503, 0.59, 0.61)]
    start, end = np.array(ends).swapaxes(0, 1)
    with Scene.of(world([ap("a", 0, 0)]), floor) as scene:
        np.testing.assert_array_equal(scene.cast(start, end) >= 0, [True, False, False, False])
    wide = world([ap("a", 0, 0)], clearance_m=0.1)
    assert ray_growth_m(wide) == pytest.approx(0.102)
    with Scene.of(wide, floor) as scene:
        np.testing.assert_array_equal(scene.cast(start, end) >= 0, [True, True, True, False])


def test_many_boxes_of_one_size_are_all_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Batches are cut and grouped by size and turn; each box still answers under its own index."""
    monkeypatch.setattr(scene_module, "MAX_BATCH", 7)
    rng = np.random.default_rng(2)
    place = np.column_stack((np.arange(90.0) * 3, np.zeros(90), np.ones(90)))
    half = np.where(rng.random((90, 1)) < 0.5, 0.5, 0.8) * np.ones(3)
    yaw = rng.choice([0.0, 0.5], 90)
    with Scene(boxes(place, half, yaw)) as scene:
        aside = np.array([0.0, 9.0, 0.0])
        hit = scene.cast(place - aside, place + aside)
    np.testing.assert_array_equal(hit, np.arange(90))


def test_an_empty_scene_blocks_nothing() -> None:
    """Without boxes every ray is free, and no rays are no error."""
    with Scene(boxes()) as scene:
        assert scene.cast((0, 0, 1), [(9, 9, 1)])[0] == -1
        assert scene.cast(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)


def test_moving_bodies_block_hide_and_go() -> None:
    """A moving body answers under a handle of its own, wherever it is, as long as it is there."""
    ray = ((0.0, 0.0, 1.0), [(10.0, 0.0, 1.0)])
    with Scene(boxes([(5.0, 9.0, 1.0)])) as scene:
        truck = scene.add_body((3.0, 0.0, 1.0), (0.5, 0.5, 1.0))
        pallet = scene.add_body((6.0, 0.0, 1.0), (0.5, 0.5, 1.0), hidden=True)
        assert (truck, pallet) == (1, 2)
        assert scene.cast(*ray)[0] == truck
        scene.move_body(truck, (3.0, 5.0, 1.0), 0.4)
        assert scene.cast(*ray)[0] == -1
        assert scene.cast((0, 5, 1), [(9, 5, 1)])[0] == truck
        scene.hide_body(pallet, False)
        assert scene.cast(*ray)[0] == pallet
        assert scene.cast((6, 0, 1), [(6, 9, 1)])[0] == pallet, "the ray starts in it"
        scene.hide_body(pallet)
        assert scene.cast(*ray)[0] == -1
        assert scene.cast((6, 0, 1), [(6, 9, 1)])[0] == -1, "nor is it met from within"
        scene.remove_body(pallet)
        assert scene.add_body((3.0, 0.0, 1.0), (0.5, 0.5, 1.0)) == 3, "handles are not reused"
        assert scene.cast(*ray)[0] == 3
        with pytest.raises(ValueError, match="no moving body 2"):
            scene.move_body(pallet, (0.0, 0.0, 0.0))
        with pytest.raises(ValueError, match="no moving body 0"):
            scene.remove_body(0)


def test_moving_bodies_are_exact_wherever_they_move() -> None:
    """After a move a body answers as a static box at that place would."""
    rng = np.random.default_rng(4)
    start, end = random_ends(rng, 1500, 20.0)
    with Scene(boxes()) as scene:
        half = rng.uniform(0.3, 2.0, (12, 3))
        handles = [scene.add_body((0.0, 0.0, 0.0), h) for h in half]
        for _ in range(3):
            center = np.column_stack((rng.uniform(0, 20, (12, 2)), rng.uniform(0, 2, 12)))
            yaw = rng.uniform(-3, 3, 12)
            for handle, c, turn in zip(handles, center, yaw, strict=True):
                scene.move_body(handle, c, turn)
            blocked = np.isfinite(entries(boxes(center, half, yaw), start, end)).any(axis=1)
            np.testing.assert_array_equal(scene.cast(start, end) >= 0, blocked)


def test_scenes_do_not_meddle_with_each_other() -> None:
    """Two open scenes answer for their own boxes; a closed one does not answer."""
    ray = ((0.0, 0.0, 1.0), [(10.0, 0.0, 1.0)])
    full = Scene(boxes([(5.0, 0.0, 1.0)]))
    with full, Scene(boxes()) as empty:
        assert full.cast(*ray)[0] == 0
        assert empty.cast(*ray)[0] == -1
    full.close()
    with pytest.raises(ValueError, match="closed"):
        full.cast(*ray)


@pytest.mark.parametrize("end", [(0.0, np.nan, 1.0), (0.0, np.inf, 1.0)])
def test_rays_to_nowhere_are_refused(end: tuple[float, float, float]) -> None:
    """NaN and infinity are errors, not line of sight."""
    with Scene(boxes()) as scene, pytest.raises(ValueError, match="finite"):
        scene.cast((0, 0, 0), [end])


def test_the_engine_prints_nothing() -> None:
    """Importing and using the engine leaves standard output and error to the user."""
    code = (
        "from tests.worlds.floors import boxes; from worlds.scene import Scene\n"
        "with Scene(boxes([(5, 0, 1)])) as s: assert s.cast((0, 0, 1), [(9, 0, 1)])[0] == 0\n"
        "import os, sys; print('out'); print('err', file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("out\n", "err\n")


@pytest.mark.parametrize(
    ("turn", "width"), [(0.0, 1.0), (np.pi / 4, np.sqrt(2.0))], ids=["along faces", "across"]
)
@pytest.mark.parametrize(("share", "side_m"), [(0.1, 2.0), (0.3, 2.0)])
def test_share_in_sight_is_that_of_tr_38_901(
    share: float, side_m: float, turn: float, width: float
) -> None:
    """InF: LOS probability exp(−d/k), k = −d_clutter / ln(1 − r) (TR 38.901, table 7.4.2-1).

    d_clutter is the width the clutter shows to the ray: its side, or its diagonal. The boxes
    are scattered independently (they may overlap), which is what the formula supposes.
    """
    rng = np.random.default_rng(11)
    hall_m, rays, k = 200.0, 2000, -side_m / np.log1p(-share) / width
    free, open_start, distance = [], [], []
    for _ in range(8):  # one hall alone is off by 2 %
        count = rng.poisson(-np.log1p(-share) * (hall_m / side_m) ** 2)
        center = np.column_stack((rng.uniform(0, hall_m, (count, 2)), np.ones(count)))
        angle = turn + rng.integers(0, 4, rays) * (np.pi / 2)
        length = rng.uniform(0.2 * k, 2 * k, rays)
        start = np.column_stack((rng.uniform(0.2, 0.8, (rays, 2)) * hall_m, np.full(rays, 0.5)))
        step = length[:, None] * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(rays)))
        with Scene(boxes(center, (side_m / 2, side_m / 2, 1.0)), grow_m=0.0) as scene:
            is_open = scene.cast(start, start) < 0
            free.append(scene.cast(start[is_open], (start + step)[is_open]) < 0)
        open_start.append(is_open)
        distance.append(length[is_open])
    sight, d = np.concatenate(free), np.concatenate(distance)
    assert np.mean(open_start) == pytest.approx(1 - share, abs=0.01)
    assert sight.mean() == pytest.approx(np.exp(-d / k).mean(), abs=0.025)
    for near in (0.2, 0.5, 1.0, 1.5):
        ring = (d >= near * k) & (d < (near + 0.3) * k)
        assert sight[ring].mean() == pytest.approx(np.exp(-d[ring] / k).mean(), abs=0.04)


@pytest.mark.parametrize("own_first", [True, False])
def test_a_body_that_reaches_into_ones_own_shades(own_first):
    """Who is about to leave its goal and who follows into it overlap; their tops are met together.

    A robot's own body never shades its antenna, the other one does, whichever was there first.
    """
    hall = World.model_validate(
        {
            "name": "goal",
            "hall": {"size_m": (14.0, 14.0), "pitch_m": 2.0,
                     "body": {"height_m": 1.5, "antenna_m": 0.8}},
            "ap": [{"id": "ap0", "position_m": (6.06, 5.63, 4.0)}],
            "robots": {"random": {"count": 1}},
        }
    )  # fmt: skip
    floor = resolve(hall)
    half = (0.35, 0.25, 0.75)
    bodies = {"own": ((7.0, 5.0, 0.75), -np.pi / 2), "other": ((6.5, 5.0, 0.75), 0.0)}
    links = LinkModel(hall)
    antenna = links.antenna_m(np.array([[7.0, 5.0]]))
    with Scene.of(hall, floor) as scene:
        order = ["own", "other"] if own_first else ["other", "own"]
        handle = {name: scene.add_body(bodies[name][0], half, bodies[name][1]) for name in order}
        shaded, blocker = links.measure(scene, 0, antenna, own=handle["own"])
        assert blocker.tolist() == [handle["other"]]
        scene.hide_body(handle["other"])
        free, blocker = links.measure(scene, 0, antenna, own=handle["own"])
        assert blocker.tolist() == [-1]
    assert shaded[0] < free[0] - 3.0
