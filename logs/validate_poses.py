"""Step 3 of validation, the bodies in space: poses, obstacles, clearances.

Poses lie where the states say the robots are at that instant, on the segment between two vertices
at the right share of it, so there is no teleport and no speed but that of the edge. Bodies keep out
of obstacles and of each other; the clearance of each slot is computed anew.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from logs.mcap_format import time_ns
from logs.records import Sample, Separation
from logs.validate_bodies import Motions, candidates, least_clearance
from logs.validate_context import METRES, STEP, Bools, Context, Floats, Ints, SlotView
from logs.validate_disturbances import DisturbanceCheck
from logs.validate_incidents import IncidentCheck
from worlds.boxes import footprint_hits, swept
from worlds.errands import robot_height_m

_POSE, _SEPARATION = "page5:pose", "page5:separation"
NO_CLEARANCE_M = -1000.0
_PAIRS_AT_ONCE = 50_000
_SAME_M = 9  # decimals to which equal strips are equal


class PoseCheck:
    """Checks the poses of each sample, and in batches of slots what the bodies come near to."""

    def __init__(
        self, context: Context, incidents: IncidentCheck, disturbances: DisturbanceCheck
    ) -> None:
        body = context.inputs.world.hall.body
        self._context = context
        self._incidents = incidents
        self._disturbances = disturbances
        self._caught: dict[int, str] = {}  # robots that touch a blockage in the slot
        self._body = body
        self._half_m = np.array([body.length_m / 2.0, body.width_m / 2.0])
        self._height_m = robot_height_m(context.inputs.world)
        self._heading: Floats = np.empty(0)  # of the slot's first sample, by robot
        self._separations: dict[int, Separation] = {}
        # Queues of what is measured together: pairs of bodies, and strips they sweep.
        self._pairs: list[tuple[int, Ints, Ints, Floats]] = []
        self._strips: list[tuple[int, Ints, Floats]] = []
        self._queued = 0

    def add_sample(self, sample: Sample, view: SlotView, step: int) -> None:
        """The poses of one sample, `view` telling where the robots should be."""
        context, slot = self._context, sample.slot
        robot: Ints = np.array(sample.robot, np.int64)
        context.checks.count(STEP, "page5:sample")
        if not np.array_equal(robot, view.robot):
            missing = np.setdiff1d(view.robot, robot).tolist()
            strange = np.setdiff1d(robot, view.robot).tolist()
            context.checks.find(
                STEP,
                "page5:sample",
                f"sample at {sample.t_s} s without {[context.name(i) for i in missing]}, "
                f"with {[context.name(i) for i in strange]}",
                "the robots on the floor, those and no other",
                slot=slot,
            )
        _, here, there = np.intersect1d(robot, view.robot, return_indices=True)
        robot = robot[here]
        found = np.column_stack([sample.x_m, sample.y_m])[here].reshape(-1, 2)
        share = view.fraction(step, context.steps)[there, None]
        xy = context.inputs.problem.xy_m
        expected = (1.0 - share) * xy[view.vertex[there]] + share * xy[view.next_vertex[there]]
        off = ~(np.hypot(*(found - expected).T) <= METRES)
        context.each(_POSE, slot, robot, off, f"at {sample.t_s} s x, y [m]", found, expected)
        heading = np.array(sample.heading_rad, np.float64)[here]
        if step == 0:
            self._heading = np.zeros(len(context.start.robots))
            self._heading[robot] = heading
        self._check_heading(sample, robot, heading, view, there)
        self._check_blockages(sample, robot, found, heading, view.moves[there])

    def _check_blockages(
        self, sample: Sample, robot: Ints, xy_m: Floats, heading: Floats, moves: Bools
    ) -> None:
        """No robot drives into a blockage; one that stands may be caught by it."""
        boxes = self._disturbances.boxes()
        if not len(boxes) or not len(robot):
            return
        hit = footprint_hits(boxes, xy_m, self._half_m, heading, body_height_m=self._height_m)
        touches = hit >= 0
        names, free = np.array([*boxes.name, "none"]), np.full(len(robot), "apart from it")
        what = f"at {sample.t_s} s drives and touches"
        self._context.each(
            "page5:blockage", sample.slot, robot, touches & moves, what, names[hit], free
        )
        for k in np.flatnonzero(touches).tolist():
            self._caught.setdefault(int(robot[k]), boxes.name[hit[k]])

    def _check_heading(
        self, sample: Sample, robot: Ints, heading: Floats, view: SlotView, there: Ints
    ) -> None:
        """Along the edge while moving; robots turn between two slots only."""
        xy = self._context.inputs.problem.xy_m
        way = xy[view.next_vertex[there]] - xy[view.vertex[there]]
        moves = view.moves[there]
        kept = self._heading[robot] if len(self._heading) else heading
        expected = np.where(moves, np.arctan2(way[:, 1], way[:, 0]), kept)
        turned = ~(np.abs(np.sin((heading - expected) / 2.0)) <= METRES)
        self._context.each(
            _POSE,
            sample.slot,
            robot,
            turned,
            f"at {sample.t_s} s heading [rad]",
            heading,
            expected,
        )

    def add_separation(self, separation: Separation) -> None:
        """The log's least clearance of a slot."""
        context, slot = self._context, separation.slot
        context.checks.count(STEP, _SEPARATION)
        on_time = time_ns(separation.t_s) == context.t_ns(slot + 1)
        if slot in self._separations or not on_time:
            context.checks.find(
                STEP,
                _SEPARATION,
                f"a separation at {separation.t_s} s, told twice or not at the end of its slot",
                "one per slot, at its end",
                slot=slot,
            )
        self._separations.setdefault(slot, separation)

    def close(self, view: SlotView) -> None:
        """A slot is over: queue what its bodies did."""
        heading = self._heading[view.robot] if len(self._heading) else np.zeros(len(view.robot))
        reaches = view.moves & (view.piece == view.slots - 1)
        leaves: Bools = view.arrived
        for i, name in self._caught.items():
            self._incidents.expect("caught", view.slot, (self._context.name(i), name))
        self._caught = {}
        motions = Motions(
            start_m=view.start_m,
            end_m=view.end_m,
            heading_rad=heading,
            vertex=view.vertex,
            enters=np.where(reaches, view.next_vertex, -1),
            leaves=leaves & (self._context.start.at_goal == "leave"),
        )
        a, b = candidates(motions, self._half_m)
        named = self._named(view)
        if named is not None and not motions.passes(*named).any():
            a, b = np.append(a, named[0]), np.append(b, named[1])
        self._pairs.append((view.slot, view.robot[a], view.robot[b], motions.pairs(a, b)))

        center, half, yaw = swept(view.start_m, view.end_m, self._body.length_m, self._body.width_m)
        stands = ~view.moves
        center[stands], half[stands] = view.start_m[stands], self._half_m
        yaw = np.where(stands, heading, yaw)
        self._strips.append((view.slot, view.robot, np.column_stack([center, half, yaw])))
        self._queued += len(a) + len(view.robot)
        if self._queued > _PAIRS_AT_ONCE:
            self.flush()

    def _named(self, view: SlotView) -> tuple[Ints, Ints] | None:
        """The two robots the log calls nearest, if they are on the floor."""
        separation = self._separations.get(view.slot)
        if separation is None or not separation.robot_a:
            return None
        names = (separation.robot_a, separation.robot_b)
        places = [np.flatnonzero(view.robot == self._context.robot.get(name, -1)) for name in names]
        if any(len(place) == 0 for place in places) or names[0] == names[1]:
            return None
        return places[0], places[1]

    def flush(self) -> None:
        """Measure all that is queued."""
        if not self._pairs:
            return
        clearance = least_clearance(np.concatenate([p for *_, p in self._pairs]), self._half_m)
        ends = np.cumsum([len(a) for _, a, _, _ in self._pairs])[:-1]
        for (slot, a, b, _), own in zip(self._pairs, np.split(clearance, ends), strict=True):
            self._judge_clearance(slot, a, b, own)

        strips = np.concatenate([s for *_, s in self._strips])
        kinds, which = np.unique(np.round(strips, _SAME_M), axis=0, return_inverse=True)
        boxes = self._context.inputs.floor.boxes
        hit = footprint_hits(
            boxes, kinds[:, :2], kinds[:, 2:4], kinds[:, 4], body_height_m=self._height_m
        )[which.ravel()]
        ends = np.cumsum([len(robot) for _, robot, _ in self._strips])[:-1]
        for (slot, robot, _), boxes_hit in zip(self._strips, np.split(hit, ends), strict=True):
            self._judge_obstacles(slot, robot, boxes_hit)
        self._pairs, self._strips, self._queued = [], [], 0

    def _judge_clearance(self, slot: int, a: Ints, b: Ints, clearance: Floats) -> None:
        context = self._context
        context.checks.count(STEP, "page5:bodies", len(a))
        pairs: dict[tuple[str, str], float] = {}
        for k in np.argsort(clearance, kind="stable").tolist():
            names = (context.name(int(a[k])), context.name(int(b[k])))
            pairs.setdefault((min(names), max(names)), float(clearance[k]))
        for (one, other), value in pairs.items():
            if abs(value) <= METRES:
                self._incidents.allow("contact", slot, (one, other))
            elif value < 0:
                self._incidents.expect("contact", slot, (one, other), value=value)
                context.checks.find(
                    STEP,
                    "page5:bodies",
                    f"bodies overlap by {-value:.6f} m",
                    "bodies that keep apart",
                    slot=slot,
                    robot=f"{one}, {other}",
                )
        self._judge_separation(slot, pairs, float(clearance.min()) if len(clearance) else None)

    def _judge_separation(
        self, slot: int, pairs: dict[tuple[str, str], float], least: float | None
    ) -> None:
        context, told = self._context, self._separations.pop(slot, None)
        if told is None:
            context.checks.find(STEP, _SEPARATION, "no separation", "one per slot", slot=slot)
            return
        found = f"{told.clearance_m} m between {told.robot_a!r} and {told.robot_b!r}"
        pair = (min(told.robot_a, told.robot_b), max(told.robot_a, told.robot_b))
        if least is None:
            expected = f"{NO_CLEARANCE_M}, as no two bodies are to be measured"
            fine = (told.clearance_m, *pair) == (NO_CLEARANCE_M, "", "")
        else:
            nearest = min(pairs, key=lambda names: (pairs[names], names))
            expected = f"{least:.9f} m, e.g. between {' and '.join(nearest)}"
            fine = (
                abs(told.clearance_m - least) <= METRES
                and pair in pairs
                and abs(pairs[pair] - least) <= METRES
            )
        if not fine:
            context.checks.find(STEP, _SEPARATION, found, expected, slot=slot)

    def _judge_obstacles(self, slot: int, robot: Ints, hit: NDArray[np.int32]) -> None:
        context = self._context
        inside: Bools = hit >= 0
        names = np.array([*context.inputs.floor.boxes.name, "none"])
        free = np.full(len(robot), "outside of all obstacles")
        context.each("page5:obstacle", slot, robot, inside, "touches obstacle", names[hit], free)
        for i in robot[inside].tolist():
            self._incidents.expect("obstacle", slot, (context.name(i),))

    def finish(self) -> None:
        """All slots are closed."""
        self.flush()
        for slot in self._separations:
            self._context.checks.find(
                STEP, _SEPARATION, "a separation", "none: the run has no such slot", slot=slot
            )
