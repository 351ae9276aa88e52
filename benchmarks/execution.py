"""How runs bear what goes wrong, and how fast the twin is.

python -m benchmarks execution --smoke
python -m benchmarks execution --what delays --seeds 5 -o execution.json
"""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from logs.records import Incident, Kpi, Record, Replan, RunEnd
from planner.plan import Plan
from planner.solve import SolveParams, solve
from twin.disturbances import declare
from twin.instance import Instance, open_instance, survey
from twin.twin import run as execute
from worlds.events import Delays, Event
from worlds.generate import resolve
from worlds.world import World

ROOT = Path(__file__).resolve().parents[1]
Row = dict[str, Any]


def outcome(instance: Instance, plan: Plan, world: World) -> Row:
    """What comes of a plan in a disturbed world."""
    kept: list[Record] = []

    def keep(record: Record) -> None:
        if isinstance(record, Kpi | Incident | RunEnd | Replan):
            kept.append(record)

    began = time.perf_counter()
    execute(world, instance.floor, instance.radio_map, instance.problem, plan, emit=keep)
    seconds = time.perf_counter() - began
    kpi = [r for r in kept if isinstance(r, Kpi)][-1]
    end = [r for r in kept if isinstance(r, RunEnd)][-1]
    wrong = sum(r.kind in {"collision", "contact"} for r in kept if isinstance(r, Incident))
    dead = sum(r.kind == "deadlock" for r in kept if isinstance(r, Incident))
    return {
        "seconds": seconds,
        "slots": end.slot + 1,
        "speed": end.t_s / seconds,
        "verdict": end.verdict,
        "arrived": kpi.arrived,
        "robots": kpi.robots,
        "makespan": kpi.makespan_slots,
        "planned_makespan": kpi.planned_makespan_slots,
        "makespan_ratio": kpi.makespan_slots / max(1, kpi.planned_makespan_slots),
        "travel_ratio": kpi.travel_slots / max(1, kpi.planned_travel_slots),
        "outage_s": kpi.outage_s,
        "worst_outage_s": kpi.worst_outage_s,
        "handovers": kpi.handovers,
        "held": kpi.held_slots,
        "over_capacity": kpi.overload_robot_slots,
        "replans": kpi.replans,
        "adopted": sum(r.adopted for r in kept if isinstance(r, Replan)),
        "collisions": wrong,
        "deadlocks": dead,
    }


def opened(name: str, seed: int, **overrides: object) -> tuple[Instance, Plan]:
    """A world that ships, and a plan for it by cooperative A*."""
    instance = open_instance(ROOT / f"worlds/{name}.toml", overrides=overrides, seed=seed)
    return instance, solve(instance.problem, SolveParams(method="cooperative"))


def delays(smoke: bool, seeds: int) -> Iterator[Row]:
    """Makespan over the plan's, for p_delay and number of robots, in the paper's hall."""
    for robots in (20,) if smoke else (20, 50):
        for seed in range(seeds):
            instance, plan = opened("paper_hall", seed, **{"robots.random.count": robots})
            for p in (0.05,) if smoke else (0.0, 0.02, 0.05, 0.1):
                world = declare(instance.world, delays=Delays(p_delay=p, max_delay=5))
                case = {"case": f"N={robots} p={p:g}", "seed": seed}
                yield case | outcome(instance, plan, _with(world, replan=False))


def storm(smoke: bool, seeds: int) -> Iterator[Row]:
    """Slots and slots of everything at once: nobody collides, is lost, or hangs."""
    for seed in range(1 if smoke else 20 * seeds):
        instance, plan = opened("tiny" if smoke else "paper_hall", seed,
                                **({} if smoke else {"robots.random.count": 15}))  # fmt: skip
        if plan.unserved:
            continue
        width, depth = instance.world.hall.size_m
        events = [
            {"kind": "ap-outage", "ap": instance.problem.ap_ids[seed % instance.problem.n_aps],
             "from_s": 10.0 + seed % 7, "to_s": 60.0},
            {"kind": "blockage", "name": "lift", "size_m": (2.0, 1.2), "from_s": 5.0,
             "to_s": 90.0, "way_m": [(0.0, depth / 2), (width * 0.7, depth * (seed % 5) / 5)]},
            {"kind": "delay", "robot": instance.problem.robot_ids[0], "slot": 3, "slots": 9},
        ]  # fmt: skip
        world = declare(instance.world, map(Event.model_validate, events),
                        Delays(p_delay=0.05, max_delay=6))  # fmt: skip
        yield {"case": "storm", "seed": seed} | outcome(instance, plan, world)


def outages(smoke: bool, seeds: int) -> Iterator[Row]:
    """Each access point of the paper's hall out in turn, with and without planning anew."""
    for seed in range(seeds):
        instance, plan = opened("paper_hall", seed,
                                **{"robots.random.count": 10 if smoke else 50})  # fmt: skip
        for ap in instance.problem.ap_ids[: 1 if smoke else None]:
            event = {"kind": "ap-outage", "ap": ap, "from_s": 15.0, "to_s": 120.0}
            world = declare(instance.world, [Event.model_validate(event)])
            for replan in (True, False):
                case = {"case": f"{ap} {'replan' if replan else 'no replan'}", "seed": seed}
                yield case | outcome(instance, plan, _with(world, replan=replan))


def blockages(smoke: bool, seeds: int) -> Iterator[Row]:
    """A pallet across the main aisle of the assembly hall, with and without planning anew."""
    for seed in range(seeds):
        instance, plan = opened("assembly_hall", seed, **{"delays.p_delay": 0.0})
        for replan in (True, False)[: 1 if smoke else None]:
            case = {"case": "replan" if replan else "no replan", "seed": seed}
            yield case | outcome(instance, plan, _with(instance.world, replan=replan))


def speed(smoke: bool, seeds: int) -> Iterator[Row]:
    """Simulated time over wall-clock time, records and log included, and where the time goes.

    `seconds` and `cpu_seconds` are of a whole run with its log; the phases are measured apart: the
    twin alone, the messages made of its records, and all of the log of these.
    """
    from logs.mcap_writer import RunLog
    from logs.messages import MessageStream

    cases = [("paper hall, 50 robots", "paper_hall", 50), ("warehouse, 300", "warehouse_day", 300)]
    if smoke:
        cases = [("paper hall, 10 robots", "paper_hall", 10)]
    for case, name, robots in cases:
        instance, plan = _crowded(name, robots)
        world = instance.world
        inputs: dict[str, Any] = {
            "floor": instance.floor,
            "radio_map": instance.radio_map,
            "problem": instance.problem,
            "plan": plan,
        }
        for seed in range(seeds):
            records: list[Record] = []
            with tempfile.TemporaryDirectory() as folder:
                with (
                    _Stopwatch() as whole,
                    RunLog(Path(folder) / "run.mcap", world=world, **inputs) as log,
                ):
                    execute(world, **inputs, emit=log.write)
                size = log.path.stat().st_size
                with _Stopwatch() as twin:
                    execute(world, **inputs, emit=records.append)
                with _Stopwatch() as messages:
                    stream = MessageStream(world, **inputs)
                    for record in records:
                        stream.of(record)
                with (
                    _Stopwatch() as logged,
                    RunLog(Path(folder) / "again.mcap", world=world, **inputs) as log,
                ):
                    for record in records:
                        log.write(record)
            end_s = records[-1].t_s
            yield {
                "case": case,
                "seed": seed,
                "seconds": whole.wall,
                "cpu_seconds": whole.cpu,
                "cpu_twin": twin.cpu,
                "cpu_messages": messages.cpu,
                "cpu_container": logged.cpu - messages.cpu,
                "records": len(records),
                "log_bytes": size,
                "simulated_s": end_s,
                "ms_per_slot": 1000 * whole.wall * instance.floor.slot_s / end_s,
                "speed": end_s / whole.wall,
                "speed_by_cpu": end_s / whole.cpu,
                "speed_without_log": end_s / twin.wall,
            }


class _Stopwatch:
    """Seconds spent inside `with`: of the wall clock, and of the processor, by all threads."""

    wall = cpu = 0.0

    def __enter__(self) -> _Stopwatch:
        self._began = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, *_: object) -> None:
        self.wall, self.cpu = (
            now - then
            for now, then in zip(
                (time.perf_counter(), time.process_time()), self._began, strict=True
            )
        )


def _crowded(name: str, robots: int) -> tuple[Instance, Plan]:
    """A world with more robots, room for them at its access points, and nothing that goes wrong."""
    path = ROOT / f"worlds/{name}.toml"
    overrides: dict[str, object] = {"robots.random.count": robots, "plan.objective": "tp"}
    if robots > 100:
        overrides["radio.ap_capacity"] = robots // 3
    read = open_instance(path, overrides=overrides)
    world = read.world.model_copy(update={"delays": Delays(), "event": ()})
    instance = survey(world, resolve(world))
    return instance, solve(instance.problem, SolveParams(method="cooperative"))


def _with(world: World, **options: object) -> World:
    return world.model_copy(update={"run": world.run.model_copy(update=options)})


STUDIES: dict[str, Callable[[bool, int], Iterator[Row]]] = {
    "delays": delays,
    "storm": storm,
    "outages": outages,
    "blockages": blockages,
    "speed": speed,
}


def execution(
    what: Annotated[list[str] | None, typer.Option(help="; ".join(STUDIES))] = None,
    seeds: Annotated[int, typer.Option(min=1)] = 3,
    smoke: Annotated[bool, typer.Option(help="one tiny case of each")] = False,
    output: Annotated[Path | None, typer.Option("--output", "-o")] = None,
) -> None:
    """Execute plans under disturbance: what it costs, what planning anew saves, how fast it is."""
    rows: list[Row] = []
    for name in what or list(STUDIES):
        if name not in STUDIES:
            typer.echo(f"there is no {name!r}; choose among {', '.join(STUDIES)}", err=True)
            raise typer.Exit(2)
        for row in STUDIES[name](smoke, 1 if smoke else seeds):
            rows.append({"what": name, **row})
            typer.echo(json.dumps(rows[-1]), err=True)
    if output is not None:
        output.write_text(json.dumps({"rows": rows}, indent=1) + "\n")
    groups: dict[tuple[str, str], list[Row]] = defaultdict(list)
    for row in rows:
        groups[row["what"], row["case"]].append(row)
    for (name, case), mine in groups.items():
        figures = {
            key: statistics.mean(row[key] for row in mine)
            for key, value in mine[0].items()
            if isinstance(value, int | float) and key != "seed"
        }
        said = "  ".join(f"{key} {value:.4g}" for key, value in figures.items())
        typer.echo(f"{name:10} {case:24} {said}")
