"""Step 3 of validation, common ground: who takes part, what time is cut into, what is planned."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from logs.findings import Checks
from logs.mcap_format import time_ns
from logs.records import RunStart
from logs.validate_inputs import Inputs
from logs.validate_itinerary import Itinerary

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STEP = 3
METRES = 1e-6
"""Positions that differ by more are different."""
POLICIES = {"group": "group-commit", "strict": "strict"}
"""What `run.policy` is called in RunStart."""
DECIBELS = 1e-6
"""SNRs that differ by more are different."""


@dataclass(frozen=True)
class Context:
    """What all checks of a run share.

    Attributes:
        inputs: what the run was made from.
        checks: where findings go.
        start: the RunStart that these inputs give (its policy is the log's to say).
        steps: parts of a slot from one sample to the next.
        robot, ap: index by name.
        floor_vertex, floor_edge: index on the floor of each vertex and edge of the problem.
        itinerary: the paths in force, as far as the records have been read.
        last: the run's last slot, as RunEnd tells it.
        planned_last: the slot of the plan's last arrival.
        disturbed: the run need not be as planned, slot for slot.
    """

    inputs: Inputs
    checks: Checks
    start: RunStart
    steps: int
    robot: dict[str, int]
    ap: dict[str, int]
    floor_vertex: Ints
    floor_edge: Ints
    itinerary: Itinerary
    last: int
    planned_last: int
    disturbed: bool

    @classmethod
    def of(cls, inputs: Inputs, checks: Checks, last: int | None = None) -> Context:
        """The context of a run from these inputs; `last` is its last slot, the plan's if None.

        Raises:
            ValueError: the problem is not that of the world; there is nothing to hold a run to.
        """
        from worlds.radio_map import kept_edges, kept_vertices

        world, floor, problem = inputs.world, inputs.floor, inputs.problem
        vertices, edges = kept_vertices(inputs.radio_map), kept_edges(floor, inputs.radio_map)
        if (len(vertices), len(edges)) != (problem.n_vertices, problem.n_edges):
            raise ValueError("the problem is not that of its world and radio map")
        if inputs.plan.robot_ids != problem.robot_ids:
            raise ValueError("the plan is not for the problem's robots")
        start = RunStart(
            t_s=0.0,
            world=world.name,
            slot_s=floor.slot_s,
            horizon=problem.horizon,
            samples_per_slot=world.run.samples_per_slot,
            interruption_s=world.run.interruption_s,
            threshold_db=world.radio.threshold_db,
            policy=POLICIES[world.run.policy],
            at_goal=problem.at_goal,
            seed=world.run.seed,
            robots=problem.robot_ids,
            aps=problem.ap_ids,
            ap_capacity=tuple(problem.ap_capacity.tolist()),
        )
        planned_last = max((p.arrival for p in inputs.plan.paths if p is not None), default=0)
        disturbed = bool(
            world.delays.p_delay > 0
            or world.event
            or world.run.policy != "group"
            or world.run.robots_block
        )
        return cls(
            inputs=inputs,
            checks=checks,
            start=start,
            steps=max(1, start.samples_per_slot - 1),
            robot={name: i for i, name in enumerate(start.robots)},
            ap={name: a for a, name in enumerate(start.aps)},
            floor_vertex=vertices.astype(np.int64),
            floor_edge=edges.astype(np.int64),
            itinerary=Itinerary(inputs.plan, problem, problem.at_goal == "park"),
            last=planned_last if last is None else last,
            planned_last=planned_last,
            disturbed=disturbed,
        )

    def t_ns(self, slot: int, step: int = 0) -> int:
        """Log time of an instant of a slot [ns]."""
        slot_s = self.start.slot_s
        return time_ns(slot * slot_s + step * slot_s / self.steps)

    def name(self, robot: int) -> str:
        """A robot's id."""
        return self.start.robots[robot]

    def each(
        self,
        rule: str,
        slot: int,
        robots: Ints,
        wrong: Bools,
        found: str,
        values: NDArray[np.generic],
        expected: NDArray[np.generic],
    ) -> None:
        """Count one fact per robot (n,) and find those that are wrong (n,), with both values.

        Values are (n,) or (n, …); they become text only where something is wrong.
        """
        self.checks.count(STEP, rule, len(robots))
        for k in np.flatnonzero(wrong).tolist():
            self.checks.find(
                STEP,
                rule,
                f"{found} {values[k].tolist()}",
                expected[k].tolist(),
                slot=slot,
                robot=self.name(int(robots[k])),
            )


@dataclass(frozen=True)
class SlotView:
    """What the records say the n robots on the floor do in a slot.

    Attributes:
        slot: which.
        robot: (n,) ascending.
        vertex, next_vertex: (n,) at or left last, and reached next.
        edge: (n,) is being crossed, −1 if none.
        piece: (n,) slots since the crossing was entered.
        slots: (n,) the edge takes, 1 at a vertex.
        moves: (n,) bool, position changes in this slot.
        visit: (n,) state of its path.
        advances: (n,) bool, it makes the transition of that state in this slot.
        arrived: (n,) bool, it is at its goal for good.
        ap: (n,) AP that serves at the slot's beginning, −1 for none.
        load_ap: (n,) AP it counts for: that of the vertex it left (§1.6).
        start_m, end_m: (n, 2) float64, where it is at the slot's beginning and end [m].
    """

    slot: int
    robot: Ints
    vertex: Ints
    next_vertex: Ints
    edge: Ints
    piece: Ints
    slots: Ints
    moves: Bools
    visit: Ints
    advances: Bools
    arrived: Bools
    ap: Ints
    load_ap: Ints
    start_m: Floats
    end_m: Floats

    def placed(self, xy_m: Floats) -> SlotView:
        """The same with `start_m` and `end_m` from the vertices' places (V, 2) [m]."""
        u, v = xy_m[self.vertex], xy_m[self.next_vertex]
        start, end = (self.fraction(step, 1)[:, None] for step in (0, 1))
        return replace(self, start_m=(1.0 - start) * u + start * v, end_m=(1.0 - end) * u + end * v)

    def fraction(self, step: int, steps: int) -> Floats:
        """(n,) share of the way from `vertex` to `next_vertex` at an instant of the slot."""
        return (self.piece + self.moves * (step / steps)) / self.slots
