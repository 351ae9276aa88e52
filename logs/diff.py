"""What two runs do not have in common: world, plan, key figures, and where they part.

Both logs are read record by record; nothing is kept but one instant of each and the key figures.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

from logs.errors import in_a_sentence
from logs.mcap_reader import canonical_hash
from logs.records import LINKS, ApKpi, Kpi, Record, RobotKpi, RunEnd, RunStart, Sample

if TYPE_CHECKING:
    from logs.mcap_reader import RunFile
    from planner.plan import Path, Plan
    from planner.problem import Problem

SAME_M = 1e-6
"""Places nearer than this are the same [m]."""
SAME_DB = 1e-6

_NAMED_BY = ("id", "name")


@dataclass(frozen=True, slots=True)
class Change:
    """A value that is not the same in both.

    Attributes:
        key: which, as a dotted path.
        a, b: what each log says; None where it says nothing.
    """

    key: str
    a: object
    b: object


@dataclass(frozen=True, slots=True)
class PathChange:
    """A robot that is planned otherwise.

    Attributes:
        robot: its id.
        first_slot: the first slot in which place or AP differ.
        slots, handovers, cost: of its path in a and b, None without a path.
    """

    robot: str
    first_slot: int
    slots: tuple[int | None, int | None]
    handovers: tuple[int | None, int | None]
    cost: tuple[int | None, int | None]


@dataclass(frozen=True, slots=True)
class Parting:
    """Where two runs part.

    Attributes:
        slot: the first slot in which they differ.
        t_s: when it begins, or when within it they differ, in a and in b [s].
        robots: those that differ at that instant, and in what.
    """

    slot: int
    t_s: tuple[float, float]
    robots: tuple[Change, ...]


@dataclass(frozen=True)
class Difference:
    """Everything two logs do not have in common.

    Attributes:
        a, b: their paths.
        same: whether their contents are the same, byte by byte (`ContentHash`).
        versions: of the software that wrote them.
        world: keys of the world.
        plan: figures of the plan.
        paths: robots with other paths.
        figures: key figures of the run.
        robots, aps: key figures of single robots and APs, the key beginning with the id.
        places: where the robots' ways part, None if they are at the same places all the time.
        links: the same for serving AP, link and SNR, as long as the places are the same.
    """

    a: str
    b: str
    same: bool
    versions: tuple[Change, ...]
    world: tuple[Change, ...]
    plan: tuple[Change, ...]
    paths: tuple[PathChange, ...]
    figures: tuple[Change, ...]
    robots: tuple[Change, ...]
    aps: tuple[Change, ...]
    places: Parting | None
    links: Parting | None

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values, for JSON; numbers it does not know (NaN) as text."""
        plain: dict[str, Any] = _plain(asdict(self))
        return plain


def diff(a: RunFile, b: RunFile) -> Difference:
    """Compare two logs.

    Raises:
        LogError: one of them is damaged or lacks an input.
    """
    with in_a_sentence(a.path, f"compared with {b.path}"):
        return _diff(a, b)


def _diff(a: RunFile, b: RunFile) -> Difference:
    figures_a, figures_b = _figures(a), _figures(b)
    places, links = _partings(a, b)
    return Difference(
        a=str(a.path),
        b=str(b.path),
        same=canonical_hash(a.path) == canonical_hash(b.path),
        versions=_changes(_versions(a), _versions(b)),
        world=_changes(world_values(a), world_values(b)),
        plan=_changes(_plan_values(a.plan, a.problem), _plan_values(b.plan, b.problem)),
        paths=tuple(_path_changes(a, b)),
        figures=_changes(figures_a[0], figures_b[0]),
        robots=_changes(figures_a[1], figures_b[1]),
        aps=_changes(figures_a[2], figures_b[2]),
        places=places,
        links=links,
    )


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


# --- values ---------------------------------------------------------------------------------------


def world_values(run: RunFile) -> dict[str, object]:
    """Every key of a world that has a value, as a dotted path; parts of lists by id or name."""
    found: dict[str, object] = {}
    _flatten("", run.world.model_dump(mode="json", exclude_none=True), found)
    return found


def _flatten(path: str, value: object, found: dict[str, object]) -> None:
    if isinstance(value, Mapping):
        for key, part in value.items():
            _flatten(f"{path}.{key}" if path else str(key), part, found)
    elif isinstance(value, list) and value and all(isinstance(part, Mapping) for part in value):
        names = [next((str(p[k]) for k in _NAMED_BY if p.get(k)), "") for p in value]
        unique = len(set(names)) == len(names) and all(names)
        for k, part in enumerate(value):
            _flatten(f"{path}.{names[k] if unique else k}", part, found)
    elif not (isinstance(value, list) and not value):  # an empty list is nothing
        found[path] = value


def _versions(run: RunFile) -> dict[str, object]:
    return {"library": run.library, **run.metadata.get("mapp-versions", {})}


def _plan_values(plan: Plan, problem: Problem) -> dict[str, object]:
    return {
        "status": plan.status,
        "robots": len(plan.robot_ids),
        "unserved": list(plan.unserved),
        "cost": plan.cost,
        "lower_bound": plan.lower_bound,
        "gap": plan.gap,
        "slots": plan.slots,
        "handovers": plan.handovers,
        "horizon": problem.horizon,
        "objective": problem.objective,
        "c_t": problem.c_t,
        "c_h": problem.c_h,
        "vertices": problem.n_vertices,
        "edges": problem.n_edges,
    }


def _figures(run: RunFile) -> tuple[dict[str, object], dict[str, object], dict[str, object]]:
    """Key figures of the run, of each robot and of each AP."""
    whole: dict[str, object] = {}
    robots: dict[str, object] = {}
    aps: dict[str, object] = {}
    for record in run.iter_records((Kpi, RobotKpi, ApKpi, RunEnd)):
        match record:
            case Kpi():
                whole.update(_values(record))  # the last one stays
            case RunEnd():
                whole |= {"verdict": record.verdict, "message": record.message}
            case RobotKpi():
                robots |= {f"{record.robot}.{k}": v for k, v in _values(record).items()}
            case ApKpi():
                aps |= {f"{record.ap}.{k}": v for k, v in _values(record).items()}
            case _:
                pass
    return whole, robots, aps


def _values(record: Record) -> dict[str, object]:
    left_out = {"t_s", "robot", "ap"}
    return {f.name: getattr(record, f.name) for f in fields(record) if f.name not in left_out}


def _changes(a: Mapping[str, object], b: Mapping[str, object]) -> tuple[Change, ...]:
    keys = list(dict.fromkeys([*a, *b]))
    return tuple(Change(k, a.get(k), b.get(k)) for k in keys if not _equal(a.get(k), b.get(k)))


def _equal(a: object, b: object) -> bool:
    if isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b):
        return True
    return a == b


# --- paths ----------------------------------------------------------------------------------------


def _path_changes(a: RunFile, b: RunFile) -> Iterator[PathChange]:
    paths_a, paths_b = _paths(a.plan), _paths(b.plan)
    for robot in dict.fromkeys([*paths_a, *paths_b]):
        old, new = paths_a.get(robot), paths_b.get(robot)
        states = _states(a.problem, old), _states(b.problem, new)
        if states[0] == states[1]:
            continue
        pairs = zip(*states, strict=False)
        until = min(len(states[0]), len(states[1]))
        first = next((t for t, (one, other) in enumerate(pairs) if one != other), until)
        yield PathChange(
            robot,
            first,
            tuple(p and p.arrival for p in (old, new)),  # type: ignore[arg-type]
            tuple(p and p.handovers for p in (old, new)),  # type: ignore[arg-type]
            (_cost(a.problem, old), _cost(b.problem, new)),
        )


def _paths(plan: Plan) -> dict[str, Path | None]:
    return dict(zip(plan.robot_ids, plan.paths, strict=True))


def _states(problem: Problem, path: Path | None) -> list[tuple[float, float, str]]:
    """Place [m] and AP in every slot: comparable whatever the vertices are numbered."""
    if path is None:
        return []
    places = [[round(c, 6) for c in xy] for xy in problem.xy_m[path.vertices].tolist()]
    return [(x, y, problem.ap_ids[ap]) for (x, y), ap in zip(places, path.aps, strict=True)]


def _cost(problem: Problem, path: Path | None) -> int | None:
    if path is None:
        return None
    return problem.c_t * path.arrival + problem.c_h * path.handovers


# --- where they part ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Body:
    x_m: float
    y_m: float
    ap: str
    link: str
    snr_db: float

    def place(self) -> dict[str, object]:
        return {"x_m": round(self.x_m, 6), "y_m": round(self.y_m, 6)}

    def radio(self) -> dict[str, object]:
        return {"ap": self.ap, "link": self.link, "snr_db": round(self.snr_db, 6)}


@dataclass(frozen=True, slots=True)
class _Moment:
    slot: int
    number: int  # of the sample in its slot
    t_s: float
    bodies: Mapping[str, _Body]


def _partings(a: RunFile, b: RunFile) -> tuple[Parting | None, Parting | None]:
    """The first sample in which places differ, and the first one before it in which links do.

    Only those samples are compared that both logs have, by slot and number in the slot.
    """
    moments_a, moments_b = _moments(a), _moments(b)
    one, other = next(moments_a, None), next(moments_b, None)
    links: Parting | None = None
    while one is not None and other is not None:
        if (one.slot, one.number) < (other.slot, other.number):
            one = next(moments_a, None)
        elif (other.slot, other.number) < (one.slot, one.number):
            other = next(moments_b, None)
        else:
            times = (one.t_s, other.t_s)
            moved, switched = _differing(one.bodies, other.bodies)
            if switched and links is None:
                links = Parting(one.slot, times, switched)
            if moved:
                return Parting(one.slot, times, moved), links
            one, other = next(moments_a, None), next(moments_b, None)
    left = one or other
    while left is not None and not left.bodies:
        left = next(moments_a if one else moments_b, None)
    if left is None:
        return None, links
    only = {robot: body.place() for robot, body in left.bodies.items()}
    changed = [Change(r, *((place, None) if one else (None, place))) for r, place in only.items()]
    return Parting(left.slot, (left.t_s, left.t_s), tuple(changed)), links


def _moments(run: RunFile) -> Iterator[_Moment]:
    robots: Sequence[str] = ()
    aps: Sequence[str] = ()
    slot, number = -1, 0
    for record in run.iter_records((RunStart, Sample)):
        if isinstance(record, RunStart):
            robots, aps = record.robots, record.aps
        elif isinstance(record, Sample):
            number = number + 1 if record.slot == slot else 0
            slot = record.slot
            yield _Moment(slot, number, record.t_s, _bodies(record, robots, aps))


def _bodies(sample: Sample, robots: Sequence[str], aps: Sequence[str]) -> dict[str, _Body]:
    columns = (sample.robot, sample.x_m, sample.y_m, sample.ap, sample.link, sample.snr_db)
    return {
        _named(robots, robot): _Body(
            x, y, _named(aps, ap) if ap >= 0 else "", _named(LINKS, link), snr
        )
        for robot, x, y, ap, link, snr in zip(*columns, strict=False)
    }


def _named(names: Sequence[str], index: int) -> str:
    return names[index] if 0 <= index < len(names) else f"#{index}"


def _differing(
    a: Mapping[str, _Body], b: Mapping[str, _Body]
) -> tuple[tuple[Change, ...], tuple[Change, ...]]:
    """Robots at other places, and those at the same place with another link."""
    moved, switched = [], []
    for robot in dict.fromkeys([*a, *b]):
        old, new = a.get(robot), b.get(robot)
        if old is None or new is None:
            moved.append(Change(robot, old and old.place(), new and new.place()))
        elif not (abs(old.x_m - new.x_m) <= SAME_M and abs(old.y_m - new.y_m) <= SAME_M):
            moved.append(Change(robot, old.place(), new.place()))
        elif (old.ap, old.link) != (new.ap, new.link) or not (
            abs(old.snr_db - new.snr_db) <= SAME_DB
        ):
            switched.append(Change(robot, old.radio(), new.radio()))
    return tuple(moved), tuple(switched)
