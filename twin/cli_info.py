"""What `twin info` answers."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.console import Console

from twin.cli_tables import (
    Facts,
    Json,
    execution_rows,
    execution_values,
    number,
    plan_rows,
    plan_values,
    problem_rows,
    problem_values,
)
from twin.pipeline import Tally

if TYPE_CHECKING:
    from logs.mcap_reader import RunFile
    from twin.pipeline import Execution


@dataclass(frozen=True)
class Contents:
    """What one pass over a log's messages and one over its records tell.

    Attributes:
        run: the log.
        execution: how the run went.
        slot_s: length of a slot [s].
        messages: (topic, type) → how many; topics of single robots and APs count as one.
    """

    run: RunFile
    execution: Execution
    slot_s: float
    messages: dict[tuple[str, str], int]


def contents(run: RunFile) -> Contents:
    """Look through a log.

    Raises:
        LogError: it does not tell how its run ended.
    """
    from logs.errors import LogError
    from logs.records import ApKpi, Incident, Kpi, RobotKpi, RunEnd, RunStart

    messages: Counter[tuple[str, str]] = Counter()
    for message in run.iter_messages():
        parts = message.topic.split("/")
        if len(parts) == 4 and parts[1] in {"robots", "aps"}:
            parts[2] = "*"
        messages["/".join(parts), message.schema] += 1
    tally, slot_s = Tally(), 0.0
    for record in run.iter_records((RunStart, Kpi, RobotKpi, ApKpi, Incident, RunEnd)):
        tally.add(record)
        if isinstance(record, RunStart):
            slot_s = record.slot_s
    if not tally.complete:
        raise LogError(f"{run.path}: does not tell how its run ended; run the world again")
    return Contents(run, tally.result(), slot_s, dict(sorted(messages.items())))


def info_values(log: Contents) -> Json:
    """What a log holds."""
    run = log.run
    return {
        "file": str(run.path),
        "bytes": run.path.stat().st_size,
        "library": run.library,
        "content_hash": run.stored_hash,
        "metadata": {name: dict(values) for name, values in run.metadata.items()},
        "world": run.world.name,
        "slot_s": log.slot_s,
        "problem": problem_values(run.problem),
        "plan": plan_values(run.plan),
        "execution": execution_values(log.execution),
        "topics": [
            {"topic": topic, "type": kind, "messages": count}
            for (topic, kind), count in log.messages.items()
        ],
        "attachments": {name: len(data) for name, data in run.attachments.items()},
    }


def print_info(console: Console, log: Contents) -> None:
    """The same as a table."""
    run = log.run
    facts = Facts(str(run.path))
    facts.section([("world", run.world.name), *problem_rows(run.problem)])
    facts.section(plan_rows(run.plan))
    facts.section(execution_rows(log.execution, log.slot_s))
    versions = run.metadata.get("mapp-versions", {})
    facts.section(
        [
            ("written by", run.library),
            ("with", ", ".join(f"{k} {v}" for k, v in versions.items()) or "not noted"),
            ("content hash", run.stored_hash or "none"),
            ("size", number(run.path.stat().st_size, "bytes")),
        ]
    )
    facts.section(
        [
            ("messages", number(sum(log.messages.values()))),
            *(
                (topic, f"{number(count)} × {kind}")
                for (topic, kind), count in log.messages.items()
            ),
        ]
    )
    attached = [f"{name} ({number(len(data), 'bytes')})" for name, data in run.attachments.items()]
    facts.section([("attached", ", ".join(attached))])
    facts.print(console)
