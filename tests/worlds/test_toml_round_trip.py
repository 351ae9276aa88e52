"""Back to TOML, and the worlds that ship."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import worlds
from tests.worlds.good_world import GOOD
from worlds.toml_file import dump_world, open_world, parse_world
from worlds.world import World

SHIPPED = sorted(Path(worlds.__file__).parent.glob("*.toml"))
TINY = Path(worlds.__file__).parent / "tiny.toml"


text = st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]), min_size=1, max_size=12)
number = st.floats(-1000, 1000)
metres = st.floats(0.01, 100)
seed = st.integers(0, 2**63 - 1)
xy = st.tuples(number, number)


@st.composite
def parts(draw: st.DrawFn, **fields: st.SearchStrategy[Any]) -> dict[str, Any]:
    """A table in which any of the fields may be left out."""
    return {key: draw(value) for key, value in fields.items() if draw(st.booleans())}


@st.composite
def any_world(draw: st.DrawFn) -> World:
    """A valid world with anything anywhere; it need not make sense."""
    columns, rows = draw(st.integers(1, 30)), draw(st.integers(1, 30))
    pitch = draw(st.floats(0.1, 9))
    hall = {"size_m": [columns * pitch * 1.001, rows * pitch * 1.001], "pitch_m": pitch}
    if draw(st.booleans()):
        hall = {"size_m": [columns * pitch, rows * pitch], "positions": [columns, rows]}
    hall |= draw(parts(body=parts(length_m=st.floats(0.01, 20), antenna_m=st.floats(0.01, 20))))
    hall |= draw(st.sampled_from([{}, {"slot_s": 1.5}, {"speed_m_s": 0.1}]))
    stations = draw(st.lists(text, max_size=3, unique=True))
    at = st.one_of(
        st.fixed_dictionaries({"cell": st.tuples(st.integers(-9, 99), st.integers(0, 9))}),
        st.fixed_dictionaries({"at_m": xy}),
    )
    place = st.one_of(at, st.sampled_from(stations)) if stations else at
    model = st.sampled_from(["inh-office", "inf-dl"])
    world: dict[str, Any] = {
        "name": draw(text),
        "hall": hall,
        "obstacle": draw(
            st.lists(
                st.builds(
                    lambda must, may: must | may,
                    st.fixed_dictionaries({"center_m": xy, "size_m": st.tuples(metres, metres)}),
                    parts(name=text, height_m=metres, base_m=metres, yaw_deg=number),
                ),
                max_size=3,
            )
        ),
        "ap": [
            {"id": name, "position_m": [*draw(xy), draw(metres)]}
            | draw(
                parts(
                    tx_power_dbm=number,
                    gain_db=number,
                    capacity=st.integers(0, 99),
                    model=model,
                    enabled=st.booleans(),
                )
            )
            for name in draw(st.lists(text, max_size=3, unique=True))
        ],
        "station": [{"name": name} | draw(at) for name in stations],
    }
    robots = [
        {"id": name, "start": draw(place), "goal": draw(place)}
        for name in draw(st.lists(text, max_size=3, unique=True))
    ]
    if draw(st.booleans()):
        world["robot"] = robots
    else:
        world["robots"] = {"random": {"count": draw(st.integers(1, 99)), "seed": draw(seed)}}
    objective = st.one_of(
        st.sampled_from(["hp", "tp", "snr"]),
        st.fixed_dictionaries({"c_t": st.integers(0, 9), "c_h": st.integers(0, 10**9)}),
    )
    interruption = st.one_of(st.sampled_from(["sector-sweep"]), st.floats(0, 60_000))
    return World.model_validate(
        world
        | draw(
            parts(
                story=st.text(st.characters(codec="utf-8"), max_size=40),
                obstacles=st.fixed_dictionaries(
                    {"random": st.fixed_dictionaries({"share": st.floats(0, 0.99), "seed": seed})}
                ),
                radio=parts(
                    model=model,
                    threshold_db=number,
                    edge_rule=st.sampled_from(["samples", "endpoints"]),
                    shadow_fading=st.booleans(),
                ),
                plan=parts(horizon=st.integers(1, 999), objective=objective, seed=seed),
                run=parts(interruption=interruption, samples_per_slot=st.integers(1, 100)),
            )
        )
    )


@settings(max_examples=150, deadline=None)
@given(any_world())
def test_a_world_survives_being_written_and_read(world: World) -> None:
    """`parse_world(dump_world(w)) == w`, and the text is canonical: written again it is equal."""
    text = dump_world(world)
    again = parse_world(text)
    assert again == world
    assert dump_world(again) == text
    text.encode()


def test_the_canonical_text() -> None:
    """It reads as a person would write it: no defaults, a line per value, names for places."""
    assert dump_world(parse_world(GOOD)) == GOOD.replace("{ ", "{").replace(" }", "}")
    text = dump_world(
        parse_world(
            GOOD, overrides={"story": 'one\n"two"\\', "robots.random.count": 5, "robot": []}
        )
    )
    assert 'story = """\none\n\\"two\\"\\\\"""\n' in text
    assert text.endswith("[robots.random]\ncount = 5\n\n[plan]\nhorizon = 30\n")


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_shipped_worlds_open_and_survive(path: Path) -> None:
    """Every world in the package can be used as it is and be written back."""
    world, floor = open_world(path)
    assert parse_world(dump_world(world)) == world
    assert len(floor.start) == len(floor.goal) == len(floor.robot_ids) > 0
    assert world.story


def test_the_papers_hall_is_the_papers() -> None:
    """What section V of the paper prints: 20 x 20 positions over 60 m, 30 % blocked, four APs."""
    world, floor = open_world(TINY.with_name("paper_hall.toml"))
    assert (floor.columns, floor.rows) == (20, 20)
    assert floor.vertex_xy_m.min() == 0
    assert floor.vertex_xy_m.max() == pytest.approx(60)
    assert len(floor.boxes) == 120
    assert len(floor.vertex_xy_m) == 280
    assert {ap.position_m for ap in world.ap} == {(x, y, 5) for x in (15, 45) for y in (15, 45)}
    assert len(floor.robot_ids) == 50
    assert (world.plan.horizon, world.radio.ap_capacity) == (60, 15)
