"""The optional physics: each against a published figure, each felt alike by map, twin and log."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.worlds.floors import ap, grid_floor, world
from tests.worlds.radio_maps import FOUR, assert_same, paper_floor
from worlds import channel, fading
from worlds.antenna import own_angles_deg, pattern_db
from worlds.link import LinkModel, edge_xy_m
from worlds.radio_map import build_radio_map
from worlds.scene import Scene
from worlds.toml_file import dump_world, parse_world
from worlds.world import Antenna, Radio

ALL: dict[str, object] = {
    "shadow_fading": True,
    "fading_correlation": "table",
    "oxygen": True,
    "blockage": "knife-edge",
    "low_antenna_los_db": 10.7,
    "low_antenna_nlos_db": 6.0,
}
TURNED = tuple(
    station.model_copy(update={"antenna": Antenna(azimuth_deg=45.0 + 90 * k, tilt_deg=20.0)})
    for k, station in enumerate(FOUR)
)


# Oxygen (TR 38.901, 7.6.1)


@pytest.mark.parametrize(
    ("ghz", "db_per_km"),
    [
        (28.0, 0.0),
        (52.0, 0.0),
        (53.0, 1.0),
        (57.0, 9.7),
        (60.0, 15.0),
        (62.0, 14.3),
        (63.5, 8.65),
        (67.0, 1.0),
        (68.0, 0.0),
        (100.0, 0.0),
    ],
)
def test_oxygen_absorbs_what_the_table_says(ghz: float, db_per_km: float) -> None:
    """Table 7.6.1-1, linear in between: 15 dB/km at 60 GHz, nothing at 28 GHz."""
    np.testing.assert_allclose(channel.oxygen_db([1000.0, 100.0], ghz), [db_per_km, db_per_km / 10])


def test_oxygen_lowers_the_snr_by_distance() -> None:
    """Of a link of 100 m at 60 GHz it takes 1.5 dB; switched off, nothing."""
    at = np.array([[100.0, 0.0, 5.0]])
    off, on = (
        LinkModel(world([ap("a", 0, 0)], oxygen=o)).snr_db(0, at, True) for o in (False, True)
    )
    assert (off - on)[0] == pytest.approx(1.5)


# Low antennas


def test_low_antennas_lose_a_margin_by_sight() -> None:
    """10.7 dB with and 6.0 dB without line of sight, as measured (arXiv 2302.12142)."""
    at = np.array([[20.0, 0.0, 0.5]] * 2)
    sight = [True, False]
    plain = LinkModel(world([ap("a", 0, 0)])).snr_db(0, at, sight)
    low = LinkModel(world([ap("a", 0, 0)], low_antenna_los_db=10.7, low_antenna_nlos_db=6.0))
    np.testing.assert_allclose(plain - low.snr_db(0, at, sight), [10.7, 6.0])


def test_coverage_known_without_rays_stays_right_when_sight_is_the_worse() -> None:
    """A margin with sight larger than the loss without it must not fool the saving of rays."""
    floor = paper_floor(2)
    hall = world(FOUR, model="inf-dh", low_antenna_los_db=25.0, threshold_db=12.0)
    exact = build_radio_map(hall, floor)
    quick = build_radio_map(hall, floor, exact=False)
    assert not exact.edge_covered.all()
    np.testing.assert_array_equal(quick.edge_covered, exact.edge_covered)


# Directional antennas (TR 38.901, table 7.3-1)


def away(azimuth_deg: float, down_deg: float) -> np.ndarray:
    """A direction, counter-clockwise from x and down from the horizontal, as (1, 3) metres."""
    a, d = math.radians(azimuth_deg), math.radians(down_deg)
    x, y = math.cos(d) * math.cos(a), math.cos(d) * math.sin(a)
    return 7.0 * np.array([[x, y, -math.sin(d)]])


@pytest.mark.parametrize(
    ("azimuth", "tilt"), [(0.0, 0.0), (130.0, 0.0), (-70.0, 25.0), (10.0, 90.0)]
)
def test_the_pattern_is_the_tables(azimuth: float, tilt: float) -> None:
    """0 dB along the boresight, −3 dB half a beamwidth up or down, −30 dB behind."""
    antenna = Antenna(azimuth_deg=azimuth, tilt_deg=tilt)

    def loss(azimuth_deg: float, down_deg: float) -> float:
        return float(pattern_db(antenna, away(azimuth_deg, down_deg))[0])

    assert loss(azimuth, tilt) == pytest.approx(0.0, abs=1e-9)
    for off in (-32.5, 32.5):
        assert loss(azimuth, tilt + off) == pytest.approx(-3.0)
    assert loss(azimuth, tilt + 65.0) == pytest.approx(-12.0)
    assert loss(azimuth, tilt + 180.0) == pytest.approx(-30.0)
    assert pattern_db(antenna, np.zeros((1, 3)))[0] == 0.0


def test_the_pattern_is_as_wide_sideways() -> None:
    """Without tilt: −3 dB at ±32.5°, −12 dB at 65°, −30 dB from 103° on; cuts add up."""
    antenna = Antenna(azimuth_deg=40.0)
    found = [float(pattern_db(antenna, away(40.0 + off, 0.0))[0]) for off in (32.5, -32.5, 65, 110)]
    assert found == pytest.approx([-3.0, -3.0, -12.0, -30.0])
    both = float(pattern_db(antenna, away(72.5, 32.5))[0])
    assert both == pytest.approx(-6.0)
    narrow = Antenna(azimuth_deg=40.0, beamwidth_deg=10.0, front_to_back_db=20.0)
    assert float(pattern_db(narrow, away(45.0, 0.0))[0]) == pytest.approx(-3.0)
    assert float(pattern_db(narrow, away(220.0, 0.0))[0]) == pytest.approx(-20.0)


def test_angles_in_the_antennas_own_frame() -> None:
    """Tilted straight down, what is below is ahead and the horizontal is 90° off."""
    zenith, azimuth = own_angles_deg(Antenna(azimuth_deg=0.0, tilt_deg=90.0), away(0.0, 90.0))
    assert (zenith[0], azimuth[0]) == pytest.approx((90.0, 0.0))
    zenith, _ = own_angles_deg(Antenna(azimuth_deg=0.0, tilt_deg=90.0), away(0.0, 0.0))
    assert zenith[0] == pytest.approx(0.0)


def test_an_ap_that_points_somewhere_shifts_its_snr_by_the_pattern() -> None:
    """Other APs keep theirs; the gain of the AP is that of its boresight."""
    at = np.array([[30.0, 15.0, 5.0], [0.0, 15.0, 5.0]])
    plain = LinkModel(world(FOUR)).snr_db(0, at, True)
    links = LinkModel(
        world((FOUR[0].model_copy(update={"antenna": Antenna(azimuth_deg=0.0)}), FOUR[1]))
    )
    np.testing.assert_allclose(links.snr_db(0, at, True) - plain, [0.0, -30.0], atol=1e-9)
    np.testing.assert_array_equal(
        links.snr_db(1, at, True), LinkModel(world(FOUR)).snr_db(1, at, True)
    )


# Correlated shadow fading (TR 38.901, 7.4.4)


@pytest.mark.parametrize(("distance", "pitch"), [(10.0, 1.0), (6.0, 1.0), (10.0, 3.0)])
def test_fading_falls_off_exponentially(distance: float, pitch: float) -> None:
    """Empirical autocorrelation = exp(−Δ / d) along x, y and the diagonal, with sigma 1."""
    rng = np.random.default_rng(3)
    fields = [fading.correlated(rng, 50, 70, pitch, (distance,))[0] for _ in range(120)]
    field = np.array(fields)
    assert field.shape == (120, 50, 70)
    assert field.var() == pytest.approx(1.0, abs=0.08)
    assert field.mean() == pytest.approx(0.0, abs=0.08)
    for rows, columns in ((0, 1), (1, 0), (0, 4), (4, 0), (3, 3), (0, 10), (8, 8)):
        one = field[:, : 50 - rows, : 70 - columns]
        other = field[:, rows:, columns:]
        expected = math.exp(-math.hypot(rows, columns) * pitch / distance)
        assert (one * other).mean() == pytest.approx(expected, abs=0.06), (rows, columns)


def test_the_torus_is_large_enough() -> None:
    """The spectrum on it is not negative, so the covariance of the fields is exact."""
    for rows, columns, pitch, distance in (
        (1, 1, 1.0, 10.0),
        (20, 20, 3.2, 10.0),
        (9, 50, 0.5, 10.0),
    ):
        size = fading._torus(rows, columns, pitch, distance)
        spectrum = fading._spectrum(size, pitch, distance)
        assert spectrum.min() >= -1e-9 * spectrum.max()
        assert size[0] >= 2 * rows - 1
        assert size[1] >= 2 * columns - 1
        # The transform back of the spectrum is the covariance itself.
        back = np.fft.ifft2(spectrum).real
        assert back[0, 0] == pytest.approx(1.0)
        assert back[0, 1] == pytest.approx(math.exp(-pitch / distance))


def test_both_states_have_the_tables_distance() -> None:
    """InH: 10 m with sight and 6 m without; InF 10 m; fields of both states are of one noise."""
    assert channel.correlation_m("inh-office") == (10.0, 6.0)
    assert channel.correlation_m("inf-dl") == (10.0, 10.0)
    floor = grid_floor(120, 100)
    hall = world([ap("a", 60, 50)], (120, 100), shadow_fading=True, fading_correlation="table")
    links = LinkModel(hall)
    free, blocked = (
        links.fading_db(floor, np.full((12000, 1), sight)).reshape(100, 120) / sigma
        for sight, sigma in ((True, 3.0), (False, 8.03))
    )
    near = [(field[:, :-1] * field[:, 1:]).mean() / (field**2).mean() for field in (free, blocked)]
    assert near == pytest.approx([math.exp(-1 / 10), math.exp(-1 / 6)], abs=0.03)
    assert np.corrcoef(free.ravel(), blocked.ravel())[0, 1] > 0.8


def test_correlated_fading_is_nobody_elses() -> None:
    """A further AP, or further obstacles, leave a correlated draw as it was; a seed changes it."""
    options: dict[str, object] = {"shadow_fading": True, "fading_correlation": 8.0}
    floor = paper_floor(1)
    alone = build_radio_map(world(FOUR[:1], **options), floor)
    more = build_radio_map(world((FOUR[2], FOUR[0]), **options), floor)
    np.testing.assert_array_equal(more.fading_db[:, 1], alone.fading_db[:, 0])
    other = build_radio_map(world(FOUR[:1], fading_seed=5, **options), floor)
    assert abs(np.corrcoef(other.fading_db[:, 0], alone.fading_db[:, 0])[0, 1]) < 0.5
    assert (other.fading_db != alone.fading_db).any()


def test_correlated_fading_on_a_graph() -> None:
    """Nodes of a graph: correlated by their distance, as far as cells of d / 20 tell them apart."""
    from dataclasses import replace

    grid = grid_floor(60, 60, 0.25)
    graph = replace(grid, pitch_m=5.0, raster_m=0.25, node=np.arange(3600), node_id=("",) * 3600)
    halls = [
        world([ap("a", 7, 7)], shadow_fading=True, fading_correlation=5.0, fading_seed=seed)
        for seed in range(150)
    ]
    sight = np.ones((3600, 1), dtype=bool)
    drawn = np.array([LinkModel(h).fading_db(graph, sight).reshape(60, 60) / 3.0 for h in halls])
    assert (drawn**2).mean() == pytest.approx(1.0, abs=0.15)
    for apart in (4, 20, 40):
        found = (drawn[:, :, :-apart] * drawn[:, :, apart:]).mean()
        assert found == pytest.approx(math.exp(-apart * 0.25 / 5.0), abs=0.12)


# All together


@pytest.mark.parametrize("aps", [FOUR, TURNED], ids=["all directions", "turned"])
def test_map_and_twin_meet_the_same_physics(aps: tuple) -> None:  # type: ignore[type-arg]
    """With every switch on, a place measured anew has the SNR the radio map says, to 1e-9 dB."""
    floor = paper_floor(7)
    hall = world(aps, **ALL)
    found = build_radio_map(hall, floor)
    links = LinkModel(hall)
    rng = np.random.default_rng(0)
    edge, serving = rng.integers(0, len(floor.edge_uv), 400), rng.integers(0, 4, 400)
    share = rng.integers(0, 5, 400) / 4
    with Scene.of(hall, floor) as scene:
        at = links.antenna_m(edge_xy_m(floor, edge, share))
        fade = found.fading_along(floor, edge, share, serving)
        snr, blocker = links.measure(scene, serving, at, fade)
        quick = build_radio_map(hall, floor, scene=scene, exact=False)
    np.testing.assert_allclose(snr, found.snr_along(edge, share, serving), atol=1e-9)
    assert (blocker >= 0).any()
    np.testing.assert_array_equal(quick.edge_covered, found.edge_covered)
    plain = build_radio_map(world(FOUR), floor)
    assert (found.snr_db[found.los] != plain.snr_db[found.los]).all()


def test_all_switches_are_off_by_default() -> None:
    """A world that names none has the map it had before there were any."""
    floor = paper_floor(3)
    off = {"oxygen": False, "blockage": "nlos", "low_antenna_los_db": 0.0}
    assert_same(build_radio_map(world(FOUR), floor), build_radio_map(world(FOUR, **off), floor))
    assert Radio() == Radio(fading_correlation="none", low_antenna_nlos_db=0.0, **off)  # type: ignore[arg-type]


def test_the_switches_survive_the_file() -> None:
    """parse(dump(world)) == world with every key of the physics set, in words and in metres."""
    for correlation in ("table", 7.5):
        hall = world(TURNED, **(ALL | {"fading_correlation": correlation}))
        assert parse_world(dump_world(hall)) == hall


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("fading_correlation", "far", 'radio.fading_correlation: "far" must be one of none, table'),
        ("fading_correlation", 0.0, "radio.fading_correlation: 0.0 is too small; give more than 0"),
        ("fading_correlation", True, 'must be "none", "table" or a number of metres'),
        ("blockage", "knife", "did you mean 'knife-edge'?"),
        ("low_antenna_los_db", -3.0, "radio.low_antenna_los_db: -3.0 is too small"),
    ],
)
def test_wrong_switches_are_told_by_key(key: str, value: object, told: str) -> None:
    """Each mistake names key, value and remedy."""
    from tests.worlds.good_world import lines_of

    (line,) = lines_of(dump_world(world(FOUR)), **{f"radio.{key}": value})
    assert told in line


def test_worlds_are_compared_by_their_physics() -> None:
    """The key under which maps are kept tells the switches apart."""
    from worlds.radio_map_file import radio_key

    def key(**radio: object) -> str:
        return radio_key(world(FOUR, **radio))

    keys = {key(), key(oxygen=True), key(blockage="knife-edge"), key(fading_correlation="table")}
    assert len(keys | {radio_key(world(TURNED))}) == 5


def test_a_robots_own_body_does_not_shade_its_antenna() -> None:
    """By ray and by knife edges; the bodies of others do, and so does what stands before it."""
    floor = paper_floor(1)
    for blockage in ("nlos", "knife-edge"):
        hall = world(FOUR, blockage=blockage)
        links = LinkModel(hall)
        at = links.antenna_m(floor.vertex_xy_m[:40])
        with Scene.of(hall, floor) as scene:
            clear, boxes_met = links.measure(scene, 0, at)
            bodies = []
            for x, y, z in at.tolist():
                bodies.append(scene.add_body((x, y, z), (0.4, 0.3, 0.6)))
            shaded, met = links.measure(scene, 0, at)
            free, own_met = links.measure(scene, 0, at, own=bodies)
            assert (met >= len(floor.boxes)).any()
            assert (shaded < clear - 1.0).any()
            for body in bodies:
                scene.hide_body(body)
            for k, body in enumerate(bodies):
                scene.hide_body(body, False)
                alone, alone_met = links.measure(scene, 0, at[k : k + 1], own=body)
                assert alone[0] == pytest.approx(clear[k], abs=1e-9)
                assert alone_met[0] == boxes_met[k]
                scene.hide_body(body)
        assert (free <= clear + 1e-9).all()
        assert not (own_met == np.array(bodies)).any()
