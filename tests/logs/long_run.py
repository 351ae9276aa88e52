"""A long run of many robots without a planner: all of them drive round the hall for ever.

The positions of a hall form one closed tour; the robots drive along it one behind the other, as
many slots as asked for. The plan keeps the rules of page 1 and costs no time to make, so that logs
of any length can be measured:

    python -m tests.logs.long_run RUN.mcap --robots 300 --slots 900
"""

from __future__ import annotations

import argparse
import resource
import time
from itertools import pairwise
from pathlib import Path

import numpy as np

from logs.mcap_reader import read
from logs.mcap_writer import RunLog
from logs.records import Record
from logs.validate import validate
from planner.plan import Path as RobotPath
from planner.plan import Plan
from planner.problem import Problem
from twin.instance import survey
from twin.twin import run
from worlds.toml_file import parse_world

Cell = tuple[int, int]


def tour(columns: int, rows: int) -> list[Cell]:
    """A closed way over every position of a grid with an even number of rows."""
    assert rows % 2 == 0
    cells = [(0, 0)]
    for row in range(rows):
        there = range(1, columns) if row % 2 == 0 else range(columns - 1, 0, -1)
        cells += [(column, row) for column in there]
    return cells + [(0, row) for row in range(rows - 1, 0, -1)]


def world_text(robots: int, slots: int, columns: int, rows: int, aps: int) -> str:
    """The world as TOML; APs on a grid, 5 m high, some pillars of no effect on the floor."""
    cells = tour(columns, rows)
    gap = len(cells) // robots
    width, depth = 2.0 * columns, 2.0 * rows
    across = round(aps**0.5)
    lines = [
        'format = "mapp-world/1"',
        'name = "round tour"',
        f"[hall]\nsize_m = [{width}, {depth}]\npitch_m = 2.0",
        f'[radio]\nap_capacity = {robots}\nedge_rule = "endpoints"',
        f"[plan]\nhorizon = {slots}",
    ]
    for k in range(aps):
        column, row = k % across, k // across
        x, y = width * (column + 0.5) / across, depth * (row + 0.5) / -(-aps // across)
        lines.append(f'[[ap]]\nid = "ap{k}"\nposition_m = [{x:.3f}, {y:.3f}, 5.0]')
    for i in range(robots):
        start, goal = cells[i * gap], cells[(i * gap + slots) % len(cells)]
        lines.append(
            f'[[robot]]\nid = "r{i:03d}"\nstart = {{ cell = [{start[0]}, {start[1]}] }}\n'
            f"goal = {{ cell = [{goal[0]}, {goal[1]}] }}"
        )
    return "\n".join(lines) + "\n"


def tour_plan(problem: Problem, slots: int, columns: int, rows: int) -> Plan:
    """Everybody drives on along the tour in every slot, keeping its AP as long as it may."""
    place = {(round(x / 2 - 0.5), round(y / 2 - 0.5)): v for v, (x, y) in enumerate(problem.xy_m)}
    ring = [place[cell] for cell in tour(columns, rows)]
    at = {vertex: k for k, vertex in enumerate(ring)}
    edge = {frozenset(uv): e for e, uv in enumerate(problem.edge_uv.tolist())}
    assert problem.snr_db is not None
    paths = []
    for i, name in enumerate(problem.robot_ids):
        first = at[int(problem.start[i])]
        vertices = [ring[(first + t) % len(ring)] for t in range(slots + 1)]
        ap = int(problem.snr_db[vertices[0]].argmax())
        aps = [ap]
        for v in vertices[1:]:
            if not problem.cover[v, ap]:
                ap = int(problem.snr_db[v].argmax())
            aps.append(ap)
        edges = [edge[frozenset(pair)] for pair in pairwise(vertices)]
        paths.append(RobotPath(name, *(np.array(c, np.int32) for c in (vertices, aps, edges))))
    cost = sum(problem.c_t * p.arrival + problem.c_h * p.handovers for p in paths)
    return Plan("feasible", problem.robot_ids, tuple(paths), cost, 0.0)


def write_long_log(
    path: Path, robots: int, slots: int, *, columns: int = 60, rows: int = 30, aps: int = 16
) -> int:
    """Write the log of such a run; how many records it has."""
    world = parse_world(world_text(robots, slots, columns, rows, aps))
    from worlds.generate import resolve

    instance = survey(world, resolve(world))
    plan = tour_plan(instance.problem, slots, columns, rows)
    count = 0
    inputs = {
        "floor": instance.floor,
        "radio_map": instance.radio_map,
        "problem": instance.problem,
        "plan": plan,
    }
    with RunLog(path, world=world, **inputs, overwrite=True) as log:

        def emit(record: Record) -> None:
            nonlocal count
            count += 1
            log.write(record)

        run(world, **inputs, emit=emit)
    return count


def memory_mb() -> float:
    """The most memory this process has had so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Write a log, and measure what is done with it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("--robots", type=int, default=300)
    parser.add_argument("--slots", type=int, default=900)
    parser.add_argument("--do", default="write", choices=["write", "open", "validate", "records"])
    options = parser.parse_args()
    begun = time.perf_counter()
    match options.do:
        case "write":
            records = write_long_log(options.log, options.robots, options.slots)
            size = options.log.stat().st_size / 1e6
            print(f"{records} records, {size:.1f} MB")
        case "open":
            read(options.log)
        case "records":
            print(sum(1 for _ in read(options.log).iter_records()), "records")
        case "validate":
            report = validate(options.log)
            print(f"valid: {report.valid}, {sum(report.checked.values())} facts")
            print(*report.findings[:5], sep="\n")
    print(f"{time.perf_counter() - begun:.1f} s, at most {memory_mb():.0f} MB of memory")


if __name__ == "__main__":
    main()
