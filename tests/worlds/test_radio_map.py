"""What rays and channel make of a hall: SNR, sight, shadow fading, and what one asks of them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.oracles import slab
from tests.worlds.floors import ap, boxes, grid_floor, world
from tests.worlds.radio_maps import FOUR, PITCH_M, assert_same, paper_floor, tiny
from worlds.errors import WorldError
from worlds.floor import Floor
from worlds.link import LinkModel, edge_xy_m
from worlds.radio_map import RadioMap, build_radio_map, kept_edges, kept_vertices
from worlds.scene import GROW_M, Scene
from worlds.world import AccessPoint

# From rays to SNR


@pytest.mark.parametrize("fading", [False, True])
def test_snr_is_path_loss_of_the_oracles_sight_plus_fading(fading: bool) -> None:
    """At vertices and samples: SNR = link budget at the exact sight, with the map's own fading."""
    floor = paper_floor(1)
    hall = world(FOUR, shadow_fading=fading, fading_seed=3)
    found = build_radio_map(hall, floor)
    links = LinkModel(hall)
    edge = np.repeat(np.arange(len(floor.edge_uv)), 5)
    share = np.tile(np.linspace(0, 1, 5), len(floor.edge_uv))
    for a, station in enumerate(FOUR):
        for xy, snr, fade in (
            (floor.vertex_xy_m, found.snr_db[:, a], found.fading_db[:, a]),
            (
                edge_xy_m(floor, edge, share),
                found.edge_snr_db[:, :, a].ravel(),
                found.fading_along(floor, edge, share, a),
            ),
        ):
            point = np.column_stack((xy, np.full(len(xy), 0.5)))
            sight = ~np.isfinite(
                slab.entries(
                    floor.boxes.center_m,
                    floor.boxes.half_m + GROW_M,
                    floor.boxes.yaw_rad,
                    np.tile(station.position_m, (len(xy), 1)),
                    point,
                )
            ).any(axis=1)
            d = np.linalg.norm(point - station.position_m, axis=1)
            los = 32.4 + 17.3 * np.log10(d) + 20 * np.log10(60)
            nlos = np.maximum(los, 38.3 * np.log10(d) + 17.3 + 24.9 * np.log10(60))
            expected = 24 + 15 + 1 + 80 - np.where(sight, los, nlos) + fade
            np.testing.assert_allclose(snr, expected, atol=1e-9)
            np.testing.assert_allclose(links.snr_db(a, point, sight, fade), expected, atol=1e-9)
    assert found.fading_db.any() == fading


def test_blocker_is_a_box_the_ray_crosses() -> None:
    """Without line of sight the map names a box in the way, with it −1."""
    floor = paper_floor(2)
    found = build_radio_map(world(FOUR), floor)
    np.testing.assert_array_equal(found.blocker < 0, found.los)
    for a, station in enumerate(FOUR):
        hidden = np.flatnonzero(~found.los[:, a])
        end = np.column_stack((floor.vertex_xy_m[hidden], np.full(len(hidden), 0.5)))
        start = np.tile(station.position_m, (len(hidden), 1))
        enter = slab.entries(
            floor.boxes.center_m, floor.boxes.half_m + GROW_M, floor.boxes.yaw_rad, start, end
        )
        assert np.isfinite(enter[np.arange(len(hidden)), found.blocker[hidden, a]]).all()


def test_ends_of_an_edge_are_its_vertices() -> None:
    """First and last sample are the SNR at u and v themselves, fading included."""
    floor = paper_floor(3)
    found = build_radio_map(world(FOUR, shadow_fading=True), floor)
    np.testing.assert_array_equal(found.edge_snr_db[:, 0], found.snr_db[floor.edge_uv[:, 0]])
    np.testing.assert_array_equal(found.edge_snr_db[:, -1], found.snr_db[floor.edge_uv[:, 1]])


def test_ap_overrides_hold_and_disabled_aps_are_left_out() -> None:
    """Power and gain of an AP shift its SNR by as many dB, its model replaces the hall's."""
    floor = paper_floor(4)
    plain = build_radio_map(world(FOUR), floor)
    changed = build_radio_map(
        world(
            (
                ap("ap0", 15, 15, tx_power_dbm=20.0),
                ap("ap1", 45, 15, gain_db=21.0),
                ap("ap2", 15, 45, enabled=False),
                ap("ap3", 45, 45, model="inf-dl"),
            )
        ),
        floor,
    )
    assert changed.ap_ids == ("ap0", "ap1", "ap3")
    np.testing.assert_allclose(changed.snr_db[:, 0], plain.snr_db[:, 0] - 4.0)
    np.testing.assert_allclose(changed.snr_db[:, 1], plain.snr_db[:, 1] + 6.0)
    factory = build_radio_map(world(FOUR, model="inf-dl"), floor)
    np.testing.assert_array_equal(changed.snr_db[:, 2], factory.snr_db[:, 3])


@pytest.mark.parametrize("aps", [(), (ap("off", 5, 5, enabled=False),)])
def test_a_hall_without_aps_has_an_empty_map(aps: tuple[AccessPoint, ...]) -> None:
    """No enabled AP: nothing is covered, nothing is kept, nothing breaks."""
    floor = grid_floor(3, 3)
    found = build_radio_map(world(aps), floor)
    assert found.snr_db.shape == (9, 0)
    assert found.edge_handover(floor).shape == (12, 0, 0)
    assert len(kept_vertices(found)) == len(kept_edges(floor, found)) == 0
    np.testing.assert_array_equal(found.best_ap, -1)
    np.testing.assert_array_equal(found.ranked_snr_db(1), -np.inf)
    assert len(found.holes(floor)) == 9
    assert_same(RadioMap.from_bytes(found.to_bytes()), found)


def test_clearance_only_takes_sight_away() -> None:
    """A larger clearance never opens a line of sight."""
    floor = paper_floor(5)
    near, wide = (build_radio_map(world(FOUR, clearance_m=c), floor).los for c in (0.0, 0.3))
    assert not (wide & ~near).any()
    assert (near & ~wide).any()


def test_leaving_out_rays_changes_no_coverage() -> None:
    """With exact=False fewer rays are cast, and A_v, A_e and the handovers stay the same (§1.7)."""
    floor = paper_floor(6)
    for model in ("inh-office", "inf-dh"):
        hall = world(FOUR, shadow_fading=True, model=model)
        with Scene.of(hall, floor) as scene:
            exact = build_radio_map(hall, floor, scene=scene)
            every = scene.rays_cast
            quick = build_radio_map(hall, floor, scene=scene, exact=False)
            assert scene.rays_cast - every < 0.9 * every
        np.testing.assert_array_equal(quick.snr_db, exact.snr_db)
        np.testing.assert_array_equal(quick.edge_covered, exact.edge_covered)
        np.testing.assert_array_equal(quick.edge_handover(floor), exact.edge_handover(floor))
        np.testing.assert_array_equal(kept_edges(floor, quick), kept_edges(floor, exact))


def test_progress_is_told_per_ap() -> None:
    """Each AP done is reported once, in order."""
    told: list[tuple[int, int]] = []
    build_radio_map(world(FOUR), grid_floor(2, 2), on_progress=lambda *done: told.append(done))
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_an_ap_in_a_box_is_an_error() -> None:
    """An AP inside or at the very face of a box would see nothing: named, with what to do."""
    floor = grid_floor(2, 2, standing=boxes([(5.0, 5.0, 1.0)]))
    for x in (5.0, 5.5, 5.501):
        hall = world([ap("off", 5, 5, 1, enabled=False), ap("a", x, 5.0, 1.0)])
        with pytest.raises(WorldError, match=r"ap\[1\]\.position_m: AP 'a' is inside .* 'b0'"):
            build_radio_map(hall, floor)
    build_radio_map(world([ap("a", 5.503, 5.0, 1.0)]), floor)


def test_an_antenna_in_a_box_is_an_error() -> None:
    """A vertex whose antenna is inside a box is no place without line of sight but a mistake."""
    floor = grid_floor(2, 1, standing=boxes([(1.0, 0.0, 1.5)], (0.2, 0.2, 0.5)))
    build_radio_map(world([ap("a", 5, 5)], antenna_m=0.9), floor)
    with pytest.raises(WorldError, match=r"hall\.body\.antenna_m: .* \(1, 0\) .* 'b0'"):
        build_radio_map(world([ap("a", 5, 5)], antenna_m=1.2), floor)


def test_a_scene_grown_otherwise_is_refused() -> None:
    """Rays against boxes of another clearance would give another map in silence."""
    floor = paper_floor(1)
    with Scene(floor.boxes) as scene, pytest.raises(ValueError, match=r"Scene\.of"):
        build_radio_map(world(FOUR, clearance_m=0.1), floor, scene=scene)


# Symmetry


def turned(floor: Floor) -> tuple[Floor, NDArray[np.intp]]:
    """The floor turned by 90° about the hall's centre, and where each old vertex is now."""
    return _moved(floor, lambda xy: np.column_stack((60 - xy[:, 1], xy[:, 0])))


def mirrored(floor: Floor) -> tuple[Floor, NDArray[np.intp]]:
    """The floor mirrored in x."""
    return _moved(floor, lambda xy: np.column_stack((60 - xy[:, 0], xy[:, 1])))


def _moved(floor: Floor, move) -> tuple[Floor, NDArray[np.intp]]:  # type: ignore[no-untyped-def]
    center = np.column_stack((move(floor.boxes.center_m[:, :2]), floor.boxes.center_m[:, 2]))
    xy = move(floor.vertex_xy_m)
    cells = np.rint(xy / PITCH_M).astype(int)
    free = {(int(c), int(r)) for c, r in cells}
    gone = [(c, r) for c in range(20) for r in range(20) if (c, r) not in free]
    standing = boxes(center, floor.boxes.half_m)
    new = grid_floor(20, 20, PITCH_M, standing=standing, blocked=gone)
    return new, new.vertex_grid()[cells[:, 1], cells[:, 0]].astype(np.intp)


@pytest.mark.parametrize(
    ("move", "ap_order"),
    [(mirrored, [1, 0, 3, 2]), (turned, [1, 3, 0, 2])],
    ids=["mirror", "quarter turn"],
)
@pytest.mark.parametrize("seed", range(4))
def test_a_symmetric_hall_has_a_symmetric_map(seed, move, ap_order) -> None:  # type: ignore[no-untyped-def]
    """Mirrored or turned by 90°, obstacles and APs together, coverage moves along exactly."""
    floor = paper_floor(seed, side_m=PITCH_M)
    moved, where = move(floor)
    before = build_radio_map(world(FOUR), floor)
    after = build_radio_map(world(FOUR), moved)
    np.testing.assert_array_equal(after.los[where][:, ap_order], before.los)
    np.testing.assert_allclose(after.snr_db[where][:, ap_order], before.snr_db, atol=1e-9)
    edge = {tuple(sorted(uv)): index for index, uv in enumerate(moved.edge_uv.tolist())}
    at = [edge[tuple(sorted(where[uv].tolist()))] for uv in floor.edge_uv]
    np.testing.assert_array_equal(after.edge_covered[at][:, ap_order], before.edge_covered)


# Shadow fading


def open_hall(*aps: AccessPoint, seed: int = 0, columns: int = 100, rows: int = 60) -> RadioMap:
    """A large hall without boxes, with fading."""
    floor = grid_floor(columns, rows)
    return build_radio_map(world(aps, (100, 60), shadow_fading=True, fading_seed=seed), floor)


def test_fading_has_the_sigma_of_each_links_state() -> None:
    """Mean 0 and the sigma of table 7.4.1-1, by the vertex's own sight."""
    wall = boxes([(50.0, 29.5, 2.0)], (0.2, 40.0, 2.0))
    floor = grid_floor(100, 60, standing=wall, blocked=[(50, r) for r in range(60)])
    hall = world([ap("a", 25, 30)], (100, 60), shadow_fading=True)
    found = build_radio_map(hall, floor)
    los = found.los[:, 0]
    assert 2000 < los.sum() < 4000
    for sight, sigma in ((los, 3.0), (~los, 8.03)):
        drawn = found.fading_db[sight, 0]
        assert drawn.std() == pytest.approx(sigma, rel=0.05)
        assert drawn.mean() == pytest.approx(0.0, abs=3.5 * sigma / np.sqrt(len(drawn)))


def test_fading_of_aps_is_independent() -> None:
    """The draws of two APs, and of two seeds, have nothing to do with each other."""
    one = open_hall(ap("a", 25, 30), ap("b", 75, 30)).fading_db
    other = open_hall(ap("a", 25, 30), seed=1).fading_db
    for x, y in ((one[:, 0], one[:, 1]), (one[:, 0], other[:, 0])):
        assert abs(np.corrcoef(x, y)[0, 1]) < 0.05
    assert abs(np.corrcoef(one[:-1, 0], one[1:, 0])[0, 1]) < 0.05, "nor those of neighbours"


def test_nobody_shifts_anybody_elses_draw() -> None:
    """A further AP, another order or further obstacles leave every other draw as it was."""
    floor = paper_floor(1)
    alone = build_radio_map(world(FOUR[:1], shadow_fading=True), floor)
    more = build_radio_map(world((FOUR[2], FOUR[0]), shadow_fading=True), floor)
    np.testing.assert_array_equal(more.fading_db[:, 1], alone.fading_db[:, 0])

    cells = {tuple(cell): k for k, cell in enumerate(floor.vertex_cell.tolist())}
    gone = sorted(cells)[:7]
    blocked = [(c, r) for c in range(20) for r in range(20) if (c, r) not in cells]
    fewer = grid_floor(20, 20, PITCH_M, standing=floor.boxes, blocked=[*blocked, *gone])
    cut = build_radio_map(world(FOUR[:1], shadow_fading=True), fewer)
    same = [cells[tuple(cell)] for cell in fewer.vertex_cell.tolist()]
    np.testing.assert_array_equal(cut.fading_db, alone.fading_db[same])


def test_fading_runs_linearly_along_an_edge() -> None:
    """In dB between the draws of its ends, whatever the sight in between."""
    floor = paper_floor(1)
    found = build_radio_map(world(FOUR, shadow_fading=True), floor)
    edge = np.arange(len(floor.edge_uv))
    u, v = (found.fading_db[floor.edge_uv[:, end], 2] for end in (0, 1))
    for share in (0.0, 0.25, 1.0):
        along = found.fading_along(floor, edge, share, 2)
        np.testing.assert_allclose(along, u + share * (v - u), atol=1e-12)
    np.testing.assert_array_equal(found.fading_along(floor, edge, 0.0, 2), u)
    np.testing.assert_array_equal(found.fading_along(floor, edge, 1.0, 2), v)


def test_the_twin_experiences_what_the_map_predicts() -> None:
    """At vertices and sample points a ray cast anew gives the map's own SNR."""
    floor = paper_floor(7)
    hall = world(FOUR, shadow_fading=True)
    found = build_radio_map(hall, floor)
    links = LinkModel(hall)
    rng = np.random.default_rng(0)
    edge, serving = rng.integers(0, len(floor.edge_uv), 500), rng.integers(0, 4, 500)
    share = rng.integers(0, 5, 500) / 4
    with Scene.of(hall, floor) as scene:
        snr, blocker = links.measure(
            scene,
            serving,
            links.antenna_m(edge_xy_m(floor, edge, share)),
            found.fading_along(floor, edge, share, serving),
        )
    np.testing.assert_allclose(snr, found.snr_along(edge, share, serving), atol=1e-9)
    assert (blocker >= 0).any()
    assert (blocker < 0).any()


def test_the_papers_hall_gives_the_papers_graph() -> None:
    """|V'| near 52 400 and |E'| near 610 000 on average with 1 m boxes and fading (§1.11)."""
    sizes = []
    for seed in range(12):
        floor = paper_floor(seed)
        hall = world(FOUR, shadow_fading=True, fading_seed=seed, edge_rule="endpoints")
        found = build_radio_map(hall, floor)
        aps = found.covered.sum(axis=1)
        u, v = floor.edge_uv.T
        pairs = (aps**2).sum() + 2 * (aps[u] * aps[v]).sum()
        handovers = found.edge_handover(floor).sum()
        assert handovers + found.edge_covered.sum() == (aps[u] * aps[v]).sum()
        sizes.append((61 * aps.sum(), 60 * pairs))
    vertices, edges = np.mean(sizes, axis=0)
    assert vertices == pytest.approx(52_400, rel=0.02)
    assert edges == pytest.approx(610_000, rel=0.04)


# What a planner of networks asks


def test_best_second_best_and_how_many() -> None:
    """Best server (ties to the lowest index, §1.10), ranks, counts, shares."""
    snr = [[20.0, 20.0, 12.0], [5.0, 15.0, 9.0], [1.0, 2.0, 3.0]]
    radio_map, _ = tiny([[[0.0] * 3] * 2] * 2, vertex_snr_db=snr)
    np.testing.assert_array_equal(radio_map.best_ap, [0, 1, 2])
    np.testing.assert_array_equal(radio_map.ranked_snr_db(1), [20.0, 15.0, 3.0])
    np.testing.assert_array_equal(radio_map.ranked_snr_db(2), [20.0, 9.0, 2.0])
    np.testing.assert_array_equal(radio_map.ranked_snr_db(4), -np.inf)
    np.testing.assert_array_equal(radio_map.coverage_count, [3, 1, 0])
    assert radio_map.covered_share() == pytest.approx(2 / 3)
    assert radio_map.covered_share(2) == pytest.approx(1 / 3)
    assert radio_map.covered_share(threshold_db=18.0) == pytest.approx(1 / 3)


def test_holes_name_the_obstacle() -> None:
    """Each uncovered vertex with the AP that comes closest and the box in its way."""
    wall = boxes([(30.0, 0.0, 2.0)], (0.2, 5.0, 2.0))
    floor = grid_floor(13, 1, 5.0, standing=wall, blocked=[(6, 0)])
    found = build_radio_map(world([ap("a", 1.0, 0.0, 3.0)], noise_dbm=-76.0), floor)
    holes = found.holes(floor)
    assert [hole.x_m for hole in holes] == [35.0, 40.0, 45.0, 50.0, 55.0, 60.0]
    assert {(hole.ap, hole.blocker) for hole in holes} == {("a", "b0")}
    assert all(hole.snr_db < 10.0 for hole in holes)


def test_snr_between_samples_is_linear() -> None:
    """The prediction along an edge meets every sample and is linear in between."""
    radio_map, _ = tiny([[[10.0, 0.0], [20.0, 4.0], [0.0, 8.0]]])
    share = [-0.1, 0.0, 0.25, 0.5, 0.75, 1.0, 1.1]
    np.testing.assert_allclose(radio_map.snr_along(0, share, 0), [10, 10, 15, 20, 10, 0, 0])
    np.testing.assert_allclose(radio_map.snr_along(0, share, 1), [0, 0, 2, 4, 6, 8, 8])
