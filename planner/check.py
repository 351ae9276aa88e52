"""An independent judge of plans: it shares no code with any solver and re-derives every rule.

`check_plan` walks each path state by state and writes down what the robot does in which slot; then
it counts who is where. It never trusts a plan's own numbers, and whatever the plan holds (indices
that do not exist, lists of the wrong length) becomes a violation, never an exception.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field
from itertools import pairwise

from planner.plan import STATUSES, Path, Plan
from planner.problem import Problem


@dataclass(frozen=True)
class Violation:
    """One rule broken.

    Attributes:
        rule: "§1.3", of 1-semantics.
        slot: when, None where no single slot is concerned.
        robots: ids of those concerned, in the problem's order.
        message: what is there and what should be.
    """

    rule: str
    slot: int | None
    robots: tuple[str, ...]
    message: str

    def __str__(self) -> str:
        """`§1.3, slot 4, robots r00, r03: message`."""
        place = [self.rule]
        if self.slot is not None:
            place.append(f"slot {self.slot}")
        if self.robots:
            word = "robot" if len(self.robots) == 1 else "robots"
            place.append(f"{word} {', '.join(self.robots)}")
        return f"{', '.join(place)}: {self.message}"


@dataclass
class _Use:
    """Which robots (indices) use what: keys are (slot, vertex), (slot, edge) and (slot, AP)."""

    vertices: dict[tuple[int, int], list[int]] = field(default_factory=lambda: defaultdict(list))
    edges: dict[tuple[int, int], list[int]] = field(default_factory=lambda: defaultdict(list))
    aps: dict[tuple[int, int], list[int]] = field(default_factory=lambda: defaultdict(list))


def check_plan(problem: Problem, plan: Plan) -> list[Violation]:
    """All rules of 1-semantics the plan breaks; an empty list for a good plan.

    Checked are §1.1 to §1.7, §1.9, §1.12 and §1.13 so far as no solving is needed: that a bound is
    a bound, or that an instance is infeasible, cannot be seen from the plan.

    Args:
        problem: the instance, taken to be right (`Problem` validates itself).
        plan: the plan to judge; it may be malformed or partial.

    Returns:
        Violations: of single paths in the robots' order, then between robots by slot, then of the
        plan as a whole.
    """
    violations: list[Violation] = []
    paths, misfits = _paths_by_robot(problem, plan)
    violations += misfits
    use = _Use()
    for robot, path in sorted(paths.items()):
        violations += _PathCheck(problem, robot, path, use).run()
    violations += _capacity_violations(problem, use)
    return violations + _answer_violations(problem, plan, paths, not violations)


def _paths_by_robot(problem: Problem, plan: Plan) -> tuple[dict[int, Path], list[Violation]]:
    """Each path with the index of the robot it names."""
    index = {robot: i for i, robot in enumerate(problem.robot_ids)}
    violations, paths = [], {}

    def misfit(robots: tuple[str, ...], message: str) -> None:
        violations.append(Violation("§1.12", None, robots, message))

    if tuple(plan.robot_ids) != problem.robot_ids:
        misfit((), f"is a plan for {list(plan.robot_ids)}, not for {list(problem.robot_ids)}")
    if len(plan.paths) != problem.n_robots:
        misfit((), f"has {len(plan.paths)} entries for {problem.n_robots} robots")
    for position, path in enumerate(plan.paths):
        if path is None:
            continue
        robot = index.get(path.robot)
        if robot is None:
            misfit((str(path.robot),), "has a path, but the problem has no such robot")
        elif robot in paths:
            misfit((path.robot,), "has two paths")
        else:
            if robot != position:
                misfit((path.robot,), f"is robot {robot}, but its path is listed as {position}")
            paths[robot] = path
    return paths, violations


class _PathCheck:
    """One robot's path against the rules that concern it alone; notes what it uses in `use`."""

    def __init__(self, problem: Problem, robot: int, path: Path, use: _Use) -> None:
        self.problem, self.robot, self.use = problem, robot, use
        self.id = problem.robot_ids[robot]
        self.vertices: list[int] = path.vertices.tolist()
        self.aps: list[int] = path.aps.tolist()
        self.edges: list[int] = path.edges.tolist()
        self.violations: list[Violation] = []

    def run(self) -> list[Violation]:
        """Checks form, ends, states, and what happens between them."""
        if self._has_form():
            self._check_ends()
            self._walk()
            self._note_aps()
            self._note_parking()
        return self.violations

    def _add(self, rule: str, slot: int | None, message: str) -> None:
        self.violations.append(Violation(rule, slot, (self.id,), message))

    def _has_form(self) -> bool:
        """Lists of fitting lengths, made of indices that exist; all else needs that."""
        before = len(self.violations)
        states = len(self.vertices)
        if not states:
            self._add("§1.1", None, "its path has no state, not even that of slot 0")
        if len(self.aps) != states:
            self._add("§1.6", None, f"its path has {states} vertices, but {len(self.aps)} APs")
        if states and len(self.edges) != states - 1:
            self._add(
                "§1.1", None, f"its path has {states} vertices, but {len(self.edges)} edge entries"
            )
        for rule, what, entries, low, count in (
            ("§1.1", "vertex", self.vertices, 0, self.problem.n_vertices),
            ("§1.6", "AP", self.aps, 0, self.problem.n_aps),
            ("§1.1", "edge", self.edges, -1, self.problem.n_edges),
        ):
            for t, entry in enumerate(entries):
                if not low <= entry < count:
                    self._add(rule, t, f"{what} {entry} does not exist; there are {count}")
        return len(self.violations) == before

    def _check_ends(self) -> None:
        start, goal = int(self.problem.start[self.robot]), int(self.problem.goal[self.robot])
        tau = len(self.vertices) - 1
        if self.vertices[0] != start:
            self._add("§1.1", 0, f"starts at vertex {self.vertices[0]}, its start is {start}")
        if self.vertices[-1] != goal:
            self._add("§1.4", tau, f"ends at vertex {self.vertices[-1]}, its goal is {goal}")
        if tau > self.problem.horizon:
            self._add("§1.4", tau, f"arrives after the horizon, slot {self.problem.horizon}")
        if start == goal and tau > 0:
            self._add("§1.5", None, f"starts at its goal, yet takes {tau} slots instead of none")

    def _walk(self) -> None:
        """From state to state: either a wait, or a crossing of as many slots as the edge takes."""
        t, tau = 0, len(self.vertices) - 1
        self._stand(0)
        while t < tau:
            t = self._wait(t) if self.edges[t] < 0 else self._cross(t)
            self._stand(t)

    def _stand(self, t: int) -> None:
        """The robot stands at its vertex in slot t, where its AP must cover it."""
        v, a = self.vertices[t], self.aps[t]
        self.use.vertices[t, v].append(self.robot)
        if not self.problem.cover[v, a]:
            name = self.problem.ap_ids[a]
            self._add("§1.6", t, f"is served by {name}, which does not cover vertex {v}")

    def _wait(self, t: int) -> int:
        """A slot without an edge; returns the next slot at a vertex.

        A handover while waiting needs both APs at the vertex (§1.7), which `_stand` checks.
        """
        v, u = self.vertices[t], self.vertices[t + 1]
        if u != v:
            self._add("§1.1", t, f"moves from vertex {v} to {u} without crossing an edge")
        return t + 1

    def _cross(self, t: int) -> int:
        """A crossing entered in slot t; returns the slot at whose beginning it is over."""
        p, e, v = self.problem, self.edges[t], self.vertices[t]
        k, (tail, head) = int(p.edge_slots[e]), p.edge_uv[e].tolist()
        end = t + 1  # as far as the path says that this crossing goes on
        while end < t + k and end < len(self.edges) and self._on_edge(end, e, v):
            end += 1
        for slot in range(t, end):
            self.use.edges[slot, e].append(self.robot)

        if v not in (tail, head):
            self._add("§1.1", t, f"stands at vertex {v}, but crosses edge {e} of {tail} and {head}")
            return end
        forward = v == tail
        if not forward and p.edge_oneway[e]:
            self._add("§1.1", t, f"crosses edge {e} from {head} to {tail}, against its one way")
        if end < t + k:
            self._add("§1.1", t, f"is on edge {e} for {end - t} slots, but it takes {k}")
            return end
        target = head if forward else tail
        if self.vertices[end] != target:
            u = self.vertices[end]
            self._add("§1.1", t, f"crosses edge {e} from {v} to {target}, but is then at {u}")
            return end
        self._check_crossing_aps(t, end, e, forward)
        return end

    def _on_edge(self, t: int, e: int, v: int) -> bool:
        """The state of slot t can be one amid a crossing of edge e that left vertex v."""
        return self.edges[t] == e and self.vertices[t] == v

    def _check_crossing_aps(self, t: int, end: int, e: int, forward: bool) -> None:
        """§1.6: the AP of the vertex left serves until arrival; §1.7: what edge e allows."""
        p, a, b = self.problem, self.aps[t], self.aps[end]
        for slot in range(t + 1, end):
            if self.aps[slot] != a:
                self._add(
                    "§1.6",
                    slot,
                    f"is served by {p.ap_ids[self.aps[slot]]} amid edge {e}, instead of by "
                    f"{p.ap_ids[a]}, the AP it entered it with",
                )
                return
        at_u, at_v = (a, b) if forward else (b, a)
        if a == b and not p.edge_cover[e, a]:
            self._add("§1.7", t, f"crosses edge {e} with {p.ap_ids[a]}, which does not cover it")
        if a != b and not p.edge_handover[e, at_u, at_v]:
            names = f"{p.ap_ids[a]} to {p.ap_ids[b]}"
            self._add(
                "§1.7", t, f"is handed over from {names} on edge {e}, which does not allow it"
            )

    def _note_aps(self) -> None:
        for t, a in enumerate(self.aps):
            self.use.aps[t, a].append(self.robot)

    def _note_parking(self) -> None:
        """§1.4: a parked robot keeps its vertex and its AP until the horizon."""
        if self.problem.at_goal == "park":
            for t in range(len(self.vertices), self.problem.horizon + 1):
                self.use.vertices[t, self.vertices[-1]].append(self.robot)
                self.use.aps[t, self.aps[-1]].append(self.robot)


def _capacity_violations(problem: Problem, use: _Use) -> list[Violation]:
    """§1.2, §1.3 and §1.6: who meets whom, slot by slot."""
    found: list[Violation] = []

    def add(rule: str, slot: int, robots: list[int], message: str) -> None:
        names = tuple(problem.robot_ids[i] for i in sorted(set(robots)))
        found.append(Violation(rule, slot, names, message))

    for (t, v), robots in use.vertices.items():
        if len(robots) > 1:  # in slot 0 too: distinct starts are given, so these left theirs
            add("§1.2", t, robots, f"{len(robots)} robots stand at vertex {v}")
    for (t, e), robots in use.edges.items():
        if len(robots) > 1:
            ends = " and ".join(map(str, problem.edge_uv[e].tolist()))
            add("§1.3", t, robots, f"{len(robots)} robots are on edge {e} of {ends}")
    for (t, a), robots in use.aps.items():
        capacity = int(problem.ap_capacity[a])
        if len(robots) > capacity:
            text = f"{problem.ap_ids[a]} serves {len(robots)} robots, its capacity is {capacity}"
            add("§1.6", t, robots, text)
    return sorted(found, key=lambda v: (v.slot or 0, v.rule, v.message))


def _answer_violations(
    problem: Problem, plan: Plan, paths: dict[int, Path], clean: bool
) -> list[Violation]:
    """§1.9, §1.12, §1.13: cost, status and bound against the paths and each other."""
    found: list[Violation] = []

    def add(rule: str, message: str, robots: tuple[str, ...] = ()) -> None:
        found.append(Violation(rule, None, robots, message))

    cost = sum(_cost(problem, path) for path in paths.values())
    unserved = tuple(r for i, r in enumerate(problem.robot_ids) if i not in paths)
    complete, bound = not unserved, plan.lower_bound
    # Bounds are sums of floating-point duals; costs are integers.
    slack = min(1e-6 * max(1.0, abs(cost)), 1e-2)

    if plan.cost != cost:
        add("§1.9", f"claims a cost of {plan.cost}, its paths cost {cost}")
    if plan.status not in STATUSES:
        add("§1.12", f"has the status {plan.status!r}, which is none of {', '.join(STATUSES)}")
    if plan.status in {"optimal", "feasible"}:
        if unserved:
            add("§1.12", f"is called {plan.status}, but these have no path", unserved)
        if bound is None:
            add("§1.12", f"is called {plan.status}, but gives no lower bound")
    if plan.status == "unknown" and complete and clean:
        add("§1.12", 'is called unknown, but serves every robot: that is "feasible" or "optimal"')
    if plan.status == "infeasible":
        if complete and clean:
            add("§1.12", "is called infeasible, but its own paths are a plan")
        if not plan.infeasible_robots:
            add("§1.12", "is called infeasible, but names no robot")
    elif plan.infeasible_robots:
        add("§1.12", f"is called {plan.status}, yet names infeasible robots")
    strangers = tuple(r for r in plan.infeasible_robots if r not in problem.robot_ids)
    if strangers:
        add("§1.12", "are called infeasible, but are not in the problem", strangers)

    if bound is not None and not math.isfinite(bound):
        add("§1.13", f"gives {bound} as lower bound; it must be a finite number or none")
    elif bound is not None and plan.status != "infeasible" and complete and clean:
        if bound > cost + slack:
            add("§1.13", f"gives the lower bound {bound:g}, above its own cost {cost}")
        if plan.status == "optimal" and math.ceil(bound - slack) < cost:
            add("§1.13", f"is called optimal at cost {cost}, but its bound is {bound:g} only")
    lp = plan.lp_value
    if lp is not None and not math.isfinite(lp):
        add("§1.14", f"gives {lp} as value of the master LP; it must be a finite number or none")
    elif lp is not None and complete and clean and lp > cost + slack:
        add("§1.14", f"gives the master LP the value {lp:g}, above its own cost {cost}")
    return found


def _cost(problem: Problem, path: Path) -> int:
    """c_t · (slots until arrival) + c_h · (number of handovers), §1.9."""
    aps: list[int] = path.aps.tolist()
    handovers = sum(a != b for a, b in pairwise(aps))
    return problem.c_t * max(len(path.vertices) - 1, 0) + problem.c_h * handovers
