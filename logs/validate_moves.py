"""Step 3 of validation, where robots go and stand: along edges of G, nobody sharing (§1.1–3)."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from logs.validate_context import STEP, Bools, Context, Ints, SlotView
from logs.validate_incidents import IncidentCheck
from logs.validate_views import in_both


class MoveCheck:
    """Checks the moves and places of a slot."""

    def __init__(self, context: Context, incidents: IncidentCheck) -> None:
        self._context, self._incidents = context, incidents

    def check_moves(self, view: SlotView, before: SlotView | None) -> None:
        """Every move is along an edge of G, from where the robot was (§1.1)."""
        context = self._context
        problem = context.inputs.problem
        crosses = view.edge >= 0
        uv = np.append(problem.edge_uv, [[-1, -1]], axis=0)[view.edge]
        ahead = (view.vertex == uv[:, 0]) & (view.next_vertex == uv[:, 1])
        back = (view.vertex == uv[:, 1]) & (view.next_vertex == uv[:, 0])
        back &= ~np.append(problem.edge_oneway, False)[view.edge]
        fine = np.where(crosses, ahead | back, view.vertex == view.next_vertex)
        self._each_move(view, view.robot, ~fine, view.next_vertex, view.vertex)

        if before is None:
            start = problem.start[view.robot].astype(np.int64)
            self._each_move(view, view.robot, view.vertex != start, view.vertex, start)
            return
        here, there = in_both(view.robot, before.robot)
        gone_on = before.piece[there] + before.moves[there]
        amid = (before.edge[there] >= 0) & (gone_on > 0) & (gone_on < before.slots[there])
        done = before.moves[there] & (gone_on >= before.slots[there])
        expected = np.where(done, before.next_vertex[there], before.vertex[there])
        jumped = view.vertex[here] != expected
        jumped |= amid & (view.edge[here] != before.edge[there])
        self._each_move(view, view.robot[here], jumped, view.vertex[here], expected)

    def _each_move(
        self, view: SlotView, robots: Ints, wrong: Bools, found: Ints, expected: Ints
    ) -> None:
        what = "off the edges of G: at vertex"
        self._context.each("§1.1", view.slot, robots, wrong, what, found, expected)

    def check_places(self, view: SlotView) -> None:
        """Nobody shares a vertex or an edge."""
        stands, crosses = view.piece == 0, view.edge >= 0
        for rule, place, at, here in (
            ("§1.2", "vertex", view.vertex, stands),
            ("§1.3", "edge", view.edge, crosses),
        ):
            self._context.checks.count(STEP, rule, int(here.sum()))
            robots, where = view.robot[here], at[here]
            if len(np.unique(where)) == len(where):
                continue
            groups: dict[int, list[str]] = defaultdict(list)
            for i, v in zip(robots.tolist(), where.tolist(), strict=True):
                groups[v].append(self._context.name(i))
            for v, names in groups.items():
                if len(names) > 1:
                    found = f"{len(names)} robots on {place} {v}"
                    self._context.checks.find(
                        STEP, rule, found, "at most one", slot=view.slot, robot=", ".join(names)
                    )
                    for name in names:
                        self._incidents.expect("collision", view.slot, (name,))
