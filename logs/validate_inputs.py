"""Steps 1 and 2 of validation: the inputs a log carries, and the plan against its problem.

The attachments are read by the parsers a user's own files go through; then the plan is held against
the problem by `planner.check`, and the problem against what world and radio map give.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields

import numpy as np

from logs.findings import Checks
from logs.mcap_format import (
    ATTACHMENTS,
    EPOCH,
    FORMAT,
    HASH_METADATA,
    PLAN_NAME,
    PROBLEM_NAME,
    RADIO_MAP_NAME,
    RUN_METADATA,
    VERSIONS_METADATA,
    WORLD_NAME,
)
from logs.validate_container import Contents
from planner.plan import Plan
from planner.problem import Problem
from worlds.floor import Floor
from worlds.radio_map import RadioMap
from worlds.world import World

_ATTACHMENT, _METADATA = "container:attachment", "container:metadata"
_SHOWN = 5  # positions of differing array entries that a finding lists


@dataclass(frozen=True)
class Inputs:
    """What a run was made from."""

    world: World
    floor: Floor
    radio_map: RadioMap
    problem: Problem
    plan: Plan


def check_parts(contents: Contents, sha256: str, checks: Checks) -> None:
    """Attachments and metadata are there, once each, and the content hash is the stored one."""
    attached = Counter(attachment.name for attachment in contents.attachments)
    for name, media_type in ATTACHMENTS.items():
        checks.same(1, _ATTACHMENT, f"number of attachments {name!r}:", attached[name], 1)
        for attachment in contents.attachments:
            if attachment.name == name:
                checks.same(1, _ATTACHMENT, f"type of {name!r}", attachment.media_type, media_type)
    present = Counter(metadata.name for metadata in contents.metadata)
    for name in (RUN_METADATA, VERSIONS_METADATA, HASH_METADATA):
        checks.same(1, _METADATA, f"number of metadata {name!r}:", present[name], 1)
    for metadata in contents.metadata:
        values = metadata.metadata
        if metadata.name == RUN_METADATA:
            checks.same(1, _METADATA, "format", values.get("format"), FORMAT)
            checks.same(1, _METADATA, "epoch", values.get("epoch"), EPOCH)
        elif metadata.name == HASH_METADATA:
            checks.same(1, "container:hash", "content hash", values.get("sha256"), sha256)


def read_inputs(contents: Contents, checks: Checks) -> Inputs | None:
    """The attachments, parsed; None (and findings) if one of them cannot be."""
    from planner.json_files import parse_plan, parse_problem
    from worlds.errands import with_covered_robots
    from worlds.generate import resolve
    from worlds.toml_file import parse_world

    attached = {attachment.name: attachment.data for attachment in contents.attachments}
    name = ""
    try:
        name = WORLD_NAME
        world = parse_world(attached[name].decode(), name)
        floor = resolve(world)
        name = RADIO_MAP_NAME
        radio_map = RadioMap.from_bytes(attached[name])
        floor = with_covered_robots(world, floor, radio_map)
        name = PROBLEM_NAME
        problem = parse_problem(attached[name].decode(), name)
        name = PLAN_NAME
        plan = parse_plan(attached[name].decode(), problem, name)
    except KeyError:
        if name in attached:
            raise
        return None  # already found missing
    except ValueError as error:
        checks.find(1, _ATTACHMENT, f"{name} cannot be read: {error}", f"a valid {name}")
        return None
    return Inputs(world, floor, radio_map, problem, plan)


def check_inputs(inputs: Inputs, contents: Contents, checks: Checks) -> None:
    """Step 2: plan against problem, problem against world and radio map, claims against both."""
    from logs.validate_map import check_radio_map
    from planner.check import check_plan
    from planner.problem import problem_from_world

    world, floor, radio_map = inputs.world, inputs.floor, inputs.radio_map
    problem, plan = inputs.problem, inputs.plan
    for metadata in contents.metadata:
        if metadata.name == RUN_METADATA:
            named = metadata.metadata.get("world")
            checks.same(2, "page6:inputs", "world named in the metadata", named, world.name)

    checks.count(2, "§1.1", sum(len(p.vertices) for p in plan.paths if p is not None))
    for violation in check_plan(problem, plan):
        checks.find(
            2,
            violation.rule,
            violation.message,
            "a plan that keeps the rule",
            slot=violation.slot,
            robot=", ".join(violation.robots),
        )

    checks.same(
        2,
        "page6:radio-map",
        "threshold of the radio map [dB]",
        radio_map.threshold_db,
        world.radio.threshold_db,
    )
    checks.same(2, "page6:radio-map", "edge rule", radio_map.edge_rule, world.radio.edge_rule)
    checks.same(
        2,
        "page6:radio-map",
        "APs",
        radio_map.ap_ids,
        tuple(ap.id for ap in world.ap if ap.enabled),
    )
    vertices, edges, aps = len(floor.vertex_xy_m), len(floor.edge_uv), len(radio_map.ap_ids)
    samples = world.radio.samples_per_edge
    shapes = (radio_map.snr_db.shape, radio_map.edge_snr_db.shape)
    expected_shapes = ((vertices, aps), (edges, samples, aps))
    checks.same(2, "page6:radio-map", "shapes", shapes, expected_shapes)
    if shapes != expected_shapes:
        return
    check_radio_map(world, floor, radio_map, checks)
    try:
        expected = problem_from_world(world, floor, radio_map)
    except ValueError as error:
        checks.find(2, "page6:problem", f"world and radio map pose no problem: {error}", "one")
        return
    for field in fields(Problem):
        checks.count(2, "page6:problem")
        difference = differs(getattr(problem, field.name), getattr(expected, field.name))
        if difference:
            checks.find(
                2,
                "page6:problem",
                f"{field.name} of {PROBLEM_NAME}: {difference}",
                "what world and radio map give",
            )


def differs(found: object, expected: object) -> str:
    """Where two values or arrays differ, "" if they are equal (NaN equal to NaN)."""
    if not isinstance(expected, np.ndarray) or not isinstance(found, np.ndarray):
        return "" if found == expected else f"{_short(found)} instead of {_short(expected)}"
    if found.shape != expected.shape:
        return f"shape {found.shape} instead of {expected.shape}"
    unequal = found != expected
    if np.issubdtype(expected.dtype, np.floating):
        unequal &= ~(np.isnan(found) & np.isnan(expected))
    places = np.argwhere(unequal)
    if not len(places):
        return ""
    shown = ", ".join(
        f"{place.tolist()}: {found[tuple(place)]} instead of {expected[tuple(place)]}"
        for place in places[:_SHOWN]
    )
    more = f" and {len(places) - _SHOWN} more" if len(places) > _SHOWN else ""
    return f"at {shown}{more}"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
