"""A radio map as bytes: none lost, none trusted; and the key that says when to build it anew."""

from __future__ import annotations

import numpy as np
import pytest

from tests.worlds.floors import ap, world
from tests.worlds.radio_maps import FOUR, assert_same, paper_floor, tiny
from worlds import npz
from worlds.errors import WorldError
from worlds.radio_map import RadioMap, build_radio_map
from worlds.radio_map_file import radio_key
from worlds.world import (
    Body,
    Hall,
    Obstacle,
    Obstacles,
    PlanOptions,
    RandomObstacles,
    Station,
    World,
)


def test_bytes_are_the_same_each_time_and_lose_nothing() -> None:
    """A map survives its bytes to the last bit, and equal maps have equal bytes."""
    floor = paper_floor(1)
    hall = world((*FOUR, ap("café 东", 30, 30)), shadow_fading=True)
    one, two = build_radio_map(hall, floor), build_radio_map(hall, floor)
    assert one.to_bytes() == two.to_bytes()
    back = RadioMap.from_bytes(one.to_bytes())
    assert_same(back, one)
    assert back.to_bytes() == one.to_bytes()
    assert not back.snr_db.flags.writeable


def test_numpy_reads_the_bytes(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """The bytes are an ordinary .npz without pickles."""
    radio_map, _ = tiny([[[20.0, 1.0], [15.0, 2.0], [10.0, 3.0]]])
    path = tmp_path / "map.npz"
    path.write_bytes(radio_map.to_bytes())
    with np.load(path, allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["edge_snr_db"], radio_map.edge_snr_db)
        assert arrays["ap_ids"].tolist() == ["ap0", "ap1"]


def test_damaged_bytes_are_told_not_traced() -> None:
    """Cut anywhere or with any byte changed: a map that is valid, or a WorldError; nothing else."""
    radio_map, _ = tiny([[[20.0], [15.0], [10.0]]])
    good = radio_map.to_bytes()
    damaged = [good[:n] for n in range(0, len(good), 23)]
    damaged += [good[:n] + bytes([good[n] ^ 0x5A]) + good[n + 1 :] for n in range(0, len(good), 3)]
    told = []
    for data in (b"", b"PK", b"no map at all", good + good, *damaged):
        try:
            assert_same(RadioMap.from_bytes(data), radio_map)
        except WorldError as error:
            told.append(str(error))
    assert len(told) > len(damaged) // 2
    for message in told:
        assert message.startswith("radio map is not a radio map (")
        assert "build it anew" in message


def test_foreign_archives_are_told_what_is_wrong() -> None:
    """An .npz with other content names the part that does not fit."""
    radio_map, _ = tiny([[[20.0], [15.0], [10.0]]])
    fields = npz.unpack(radio_map.to_bytes())
    for change, said in (
        ({"format": np.array("mapp-radio-map/9")}, "its format is 'mapp-radio-map/9'"),
        ({"snr_db": fields["snr_db"][:1]}, r"snr_db: has shape \(1, 1\)"),
        ({"snr_db": fields["snr_db"].astype(np.float32)}, "snr_db has type float32"),
        ({"snr_db": fields["snr_db"] * np.nan}, "snr_db: holds NaN"),
        ({"blocker": fields["blocker"] + 1}, "blocker: must be −1 exactly"),
        ({"ap_ids": np.array(["a", "b"])}, "the other arrays and the APs ask for"),
        ({"edge_rule": np.array("middles")}, "edge_rule: is 'middles'"),
        ({"threshold_db": np.array([1.0, 2.0])}, "threshold_db has type float64 and shape"),
        ({"edge_snr_db": fields["edge_snr_db"][:, :1]}, "has 1 samples an edge"),
    ):
        with pytest.raises(WorldError, match=said):
            RadioMap.from_bytes(npz.pack({**fields, **change}), "run.mcap's map")
    del fields["los"]
    with pytest.raises(WorldError, match=r"run\.mcap's map is not a radio map \(los is missing\)"):
        RadioMap.from_bytes(npz.pack(fields), "run.mcap's map")


def test_arrays_are_copies_and_read_only() -> None:
    """What is done to the arrays a map was made of does not reach the map."""
    snr = np.full((1, 1), 20.0)
    radio_map = RadioMap(
        ("a",),
        10.0,
        "samples",
        snr,
        np.ones((1, 1), bool),
        -np.ones((1, 1)),
        np.empty((0, 5, 1)),
        snr,
    )
    snr[:] = 0.0
    assert radio_map.snr_db[0, 0] == 20.0
    with pytest.raises(ValueError, match="read-only"):
        radio_map.snr_db[0, 0] = 1.0


def key_world(**parts: object) -> World:
    """A world with all that a key depends on."""
    return world(FOUR).model_copy(
        update={
            "obstacle": (Obstacle(name="rack", center_m=(5.0, 5.0), size_m=(2.0, 1.0)),),
            "obstacles": Obstacles(random=RandomObstacles(share=0.1)),
            **parts,
        }
    )


def test_the_key_changes_with_all_the_map_depends_on() -> None:
    """Hall, obstacles, APs and radio are in it."""
    base = key_world()
    changes = [
        {"hall": Hall(size_m=(60.0, 61.0), pitch_m=1.0)},
        {"hall": Hall(size_m=(60.0, 60.0), pitch_m=1.0, body=Body(antenna_m=0.6))},
        {"obstacle": ()},
        {"obstacle": (Obstacle(name="rack", center_m=(5.0, 5.0), size_m=(2.0, 1.1)),)},
        {"obstacles": Obstacles(random=RandomObstacles(share=0.1, seed=1))},
        {"ap": FOUR[:3]},
        {"ap": (*FOUR[:3], ap("ap3", 45, 45, enabled=False))},
        {"ap": (*FOUR[:3], ap("ap3", 45, 45, gain_db=14.0))},
        *(
            {"radio": base.radio.model_copy(update=change)}
            for change in (
                {"frequency_ghz": 28.0},
                {"threshold_db": 9.0},
                {"samples_per_edge": 6},
                {"edge_rule": "endpoints"},
                {"clearance_m": 0.1},
                {"shadow_fading": True},
                {"fading_seed": 1},
                {"robot_gain_db": 2.0},
            )
        ),
    ]
    keys = {radio_key(key_world(**change)) for change in changes}
    assert len(keys | {radio_key(base)}) == len(changes) + 1


def test_the_key_stays_with_all_it_does_not() -> None:
    """Names, stations, robots, plan, run, capacities and rates are not in it."""
    base = key_world()
    for change in (
        {"name": "other", "story": "another"},
        {"robot": ()},
        {"station": (Station(name="dock", cell=(0, 0)),)},
        {"plan": PlanOptions(horizon=90)},
        {"hall": base.hall.model_copy(update={"slot_s": 2.0})},
        {"obstacle": (Obstacle(name="shelf", center_m=(5.0, 5.0), size_m=(2.0, 1.0)),)},
        {"ap": (*FOUR[:3], ap("ap3", 45, 45, capacity=3))},
        {"radio": base.radio.model_copy(update={"ap_capacity": 50, "bandwidth_mhz": 100.0})},
    ):
        assert radio_key(key_world(**change)) == radio_key(base)
