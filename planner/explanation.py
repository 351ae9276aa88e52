"""`Explanation`: why there is no plan, as data and in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from planner.least_room import Least
from planner.problem import Problem

SHOWN_PARTS = 8
SHOWN_ROBOTS = 12


@dataclass(frozen=True)
class AloneFault:
    """A robot that cannot reach its goal in time although alone on the floor.

    Attributes:
        robot: its id.
        least_slots: what it needs, None if no number of slots is enough.
        text: the reason in words.
    """

    robot: str
    least_slots: int | None
    text: str


@dataclass(frozen=True)
class PairFault:
    """Two robots that cannot both be served, although nobody else is on the floor.

    Attributes:
        robots: their ids.
        least_slots: no horizon below it serves both; None if no horizon does.
        text: the reason in words.
    """

    robots: tuple[str, str]
    least_slots: int | None
    text: str


@dataclass(frozen=True)
class BottleneckPart:
    """A place or an AP that is short.

    Attributes:
        kind: "position", "way" or "ap".
        name: for people, with metres.
        index: of the vertex, edge or AP.
        capacity: robots it holds at once.
        slots: ranges of slots, first and last, in which it is short.
        share: of the bottleneck's room, 0 … 1.
    """

    kind: str
    name: str
    index: int
    capacity: int
    slots: tuple[tuple[int, int], ...]
    share: float


@dataclass(frozen=True)
class Bottleneck:
    """Places in which robots need more room than there is, weighed by how scarce each is.

    Attributes:
        robots: ids of those that cannot all do without them.
        need: what they need at least, each robot at most 1.
        room: what there is, less than `need`.
        parts: the dearest first.
    """

    robots: tuple[str, ...]
    need: float
    room: float
    parts: tuple[BottleneckPart, ...]


@dataclass(frozen=True)
class Explanation:
    """Why a plan serves not all robots, and what would change that.

    Attributes:
        status: "served" (nothing to explain), "infeasible", "feasible" (there is a plan, the
            planner only did not find it) or "unknown".
        problem: what was asked: horizon and capacities.
        alone, pairs, bottleneck: the reasons that were proven.
        horizon: the least horizon with a plan, None if there is one or nothing to explain.
        capacity: the least AP capacity, the same for all APs, None likewise.
    """

    status: str
    problem: Problem
    alone: tuple[AloneFault, ...] = ()
    pairs: tuple[PairFault, ...] = ()
    bottleneck: Bottleneck | None = None
    horizon: Least | None = None
    capacity: Least | None = None

    def to_dict(self) -> dict[str, object]:
        """As plain values."""
        return {
            "status": self.status,
            "alone": [asdict(fault) for fault in self.alone],
            "pairs": [asdict(fault) for fault in self.pairs],
            "bottleneck": asdict(self.bottleneck) if self.bottleneck else None,
            "least_horizon": asdict(self.horizon) if self.horizon else None,
            "least_ap_capacity": asdict(self.capacity) if self.capacity else None,
            "sentences": [*self.reasons(), *self.remedies()],
        }

    def reasons(self) -> list[str]:
        """Why there is no plan, one sentence per reason."""
        lines = [fault.text for fault in self.alone] + [fault.text for fault in self.pairs]
        if self.bottleneck is not None:
            lines.append(_bottleneck_text(self.bottleneck))
        if self.status == "served":
            lines.append("every robot has a path: there is nothing to explain")
        elif self.status == "feasible":
            lines.append(
                "a plan for all robots exists: it was found while looking for the reason; allow "
                "the planner more iterations, or another --seed"
            )
        elif self.status == "unknown":
            lines.append("no plan was found, and no proof that there is none")
        elif not lines:
            lines.append("no plan exists: all ways to arrange the robots were ruled out")
        return lines

    def remedies(self) -> list[str]:
        """What would be enough, as far as it was searched."""
        lines = []
        if self.horizon is not None:
            lines.append(_horizon_text(self.horizon, self.problem.horizon))
        if self.capacity is not None:
            lines.append(_capacity_text(self.capacity, self.problem))
        return lines


# --- words ----------------------------------------------------------------------------------------


def _bottleneck_text(bottleneck: Bottleneck) -> str:
    robots, parts = bottleneck.robots, bottleneck.parts
    who = ", ".join(robots[:SHOWN_ROBOTS])
    who += f" and {len(robots) - SHOWN_ROBOTS} more" if len(robots) > SHOWN_ROBOTS else ""
    where = "; ".join(map(part_text, parts[:SHOWN_PARTS]))
    where += f"; and {len(parts) - SHOWN_PARTS} more" if len(parts) > SHOWN_PARTS else ""
    many = "robot needs" if len(robots) == 1 else "robots need"
    return (
        f"{len(robots)} {many} {bottleneck.need:.4g} places where there are "
        f"{bottleneck.room:.4g}: {where} (robots {who})"
    )


def part_text(part: BottleneckPart) -> str:
    """`AP ap3 (12 at once) in slots 4–9, 12`."""
    spans = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in part.slots)
    one = len(part.slots) == 1 and part.slots[0][0] == part.slots[0][1]
    room = f" ({part.capacity} at once)" if part.kind == "ap" else ""
    return f"{part.name}{room} in slot{'' if one else 's'} {spans}"


def _horizon_text(least: Least, now: int) -> str:
    if least.never:
        return "no horizon is long enough: proven"
    if least.exact:
        return f"a horizon of {least.upper} slots is enough, and none shorter (now {now})"
    none = f"proven: none below {least.lower}" if least.lower > 1 else "no proof for any"
    if least.upper is None:
        return f"no plan was found for any horizon up to {least.tried} slots (now {now}); {none}"
    between = f"{least.lower} to {least.upper - 1}"
    return (
        f"a horizon of {least.upper} slots is enough (now {now}); {none}; {between} are undecided"
    )


def _capacity_text(least: Least, problem: Problem) -> str:
    low, high = int(problem.ap_capacity.min()), int(problem.ap_capacity.max())
    now = f"now {low}" if low == high else f"now {low} to {high}"
    if least.never:
        return f"no AP capacity is enough at this horizon ({now}): proven"
    if least.exact:
        return f"an AP capacity of {least.upper} is enough, and none smaller ({now})"
    none = f"proven: none below {least.lower}" if least.lower > 1 else "no proof for any"
    if least.upper is None:
        return f"no plan was found for any AP capacity at this horizon ({now}); {none}"
    between = f"{least.lower} to {least.upper - 1}"
    return f"an AP capacity of {least.upper} is enough ({now}); {none}; {between} are undecided"
