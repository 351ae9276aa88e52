"""Branch-and-cut-and-price: the tree search that closes the gap between plan and bound.

After Lam, Le Bodic, Harabor, Stuckey ("Branch-and-cut-and-price for multi-agent path finding",
Computers & Operations Research 144, 2022, DOI 10.1016/j.cor.2022.105809) with the AP dimension,
cuts of our own (`planner.cuts`) and proofs in integers: at every node penalties p ≥ 0 on resources
and cuts give the bound Σ_i (least penalised cost of a path that the node allows) − Σ p · capacity,
all terms integers, so a node is closed by arithmetic without rounding. A node without any plan is
closed by the same argument with costs of 0 (Farkas; see `planner.phase_one`), never by an
artificial cost.

Costs are multiples of gcd(c_t, c_h), so bounds are rounded up to one. Nodes are taken by least
bound, then by greatest depth, then in the order they were made: no clock decides anything.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from planner.exact_tree import ExactParams, ExactSearch
from planner.plan import Path
from planner.resources import SCALE, Resources
from planner.search import Search

STEP_SLOTS = 8
"""How far above the bound the first target is, in slots."""


@dataclass(frozen=True)
class ExactResult:
    """What `solve_exact` knows.

    Attributes:
        paths: the best plan, or as given if none was found.
        upper: its cost, None if there is no complete plan.
        bound: proven lower bound on the cost of every plan [1/SCALE cost units].
        infeasible: proven that there is no plan.
        nodes, rounds, cuts, columns, rows: counts, over all stages; columns and rows of the last.
        lp_value: of the master at the root without cuts, None if not reached.
        root_bound: at the root with cuts, of the last stage [cost units].
    """

    paths: tuple[Path | None, ...]
    upper: int | None
    bound: int
    infeasible: bool
    nodes: int
    rounds: int
    cuts: int
    columns: int
    rows: int
    lp_value: float | None
    root_bound: float | None

    @property
    def optimal(self) -> bool:
        """Whether the plan is proven optimal."""
        return self.upper is not None and self.bound >= self.upper * SCALE


def solve_exact(
    search: Search,
    resources: Resources,
    paths: Sequence[Path | None],
    *,
    columns: Iterable[tuple[int, Path]] = (),
    bound: int = 0,
    params: ExactParams | None = None,
    stop: Callable[[], bool] = lambda: False,
    outside: Callable[[], list[Path | None] | None] = lambda: None,
    on_progress: Callable[[ExactResult], None] = lambda _result: None,
) -> ExactResult:
    """Searches until the best plan is proven optimal, or that there is none, or a limit is met.

    It goes by stages. A stage looks only for plans cheaper than a target a little above the bound:
    the less room between bound and target, the fewer paths are of interest, and the more of them
    exclude each other. A stage that finds none has raised the bound to its target.

    Args:
        search, resources: of the problem; every robot must reach its goal when alone.
        paths: the best plan known, None for robots without a path.
        columns: further (robot, path) to start with.
        bound: a proven lower bound to start with [1/SCALE cost units].
        params: limits and means.
        stop: asked after every round of pricing; True ends the search.
        outside: asked after every round of pricing for a plan found elsewhere, None without one.
        on_progress: called after every node with what is known by then.
    """
    params = params or ExactParams()
    problem = search.problem
    known = [(i, p) for i, p in enumerate(paths) if p is not None] + list(columns)
    best: list[Path | None] = list(paths)
    step = STEP_SLOTS * max(problem.c_t, 1)
    # More than any plan can cost: no target from here on.
    most = problem.n_robots * (problem.c_t + problem.c_h) * problem.horizon + 1
    nodes = rounds = cuts = 0
    lp_value: float | None = None

    def result(tree: ExactSearch, *, root: float | None, infeasible: bool = False) -> ExactResult:
        return ExactResult(
            tuple(tree.paths),
            tree.upper,
            tree.bound,
            infeasible,
            nodes + tree.nodes,
            rounds + tree.rounds,
            cuts + len(tree.pool.cuts),
            len(tree.master.columns),
            tree.master.n_rows,
            lp_value,
            root,
        )

    target: int | None = None
    first = True
    while True:
        tree = ExactSearch(
            search,
            resources,
            best,
            columns=known,
            target=target,
            bound=bound,
            params=replace(
                params,
                nodes=1 if first else None if params.nodes is None else params.nodes - nodes,
                cuts=() if first else params.cuts,
            ),
            stop=stop,
            outside=outside,
            on_node=lambda tree: on_progress(result(tree, root=tree.root_bound[1] or None)),
        )
        tree.run()
        if first:
            lp_value = tree.root_bound[0] or None
        best, bound = tree.paths, tree.bound
        known = [(c.robot, c.path) for c in tree.master.columns if c.path is not None]
        answer = result(
            tree,
            root=None if first else tree.root_bound[1] or None,
            infeasible=tree.exhausted and tree.cutoff is None,
        )
        on_progress(answer)
        out_of_nodes = params.nodes is not None and answer.nodes >= params.nodes
        if answer.optimal or answer.infeasible or stop() or out_of_nodes:
            return answer
        if not first and not tree.exhausted:
            return answer
        nodes, rounds, cuts = answer.nodes, answer.rounds, answer.cuts
        target = tree.rounded(bound) + step
        if target >= most or (tree.upper is not None and target >= tree.upper):
            target = None
        step = step if tree.upper is not None else 2 * step
        first = False


__all__ = ["ExactParams", "ExactResult", "ExactSearch", "solve_exact"]
