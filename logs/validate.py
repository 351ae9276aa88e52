"""`validate`: read a log, trust nothing in it, and say what is wrong.

Four steps (design page 6), each in files of its own; they read the file and nothing else:

1. the container (`validate_container`, `validate_payloads`, `validate_summary`) and what it must
   carry (`validate_inputs`);
2. the plan against the problem, the problem against world and radio map (`validate_inputs`);
3. the run against plan and world (`validate_run` and what it calls);
4. the key figures (`validate_kpi`).

Nothing here is shared with the twin but record types, the fold of `logs.kpi`, and the formulas and
geometry of `worlds`. What is wrong is data: a `Report` of findings. Only a file that cannot be read
at all is an exception (`LogError`): no MCAP file, or damaged before its header. A file that is cut
off, or whose CRCs do not agree, gets findings, and the checks go on as far as they can.
"""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from logs.errors import LogError
from logs.findings import Checks, Finding, Report
from logs.mapped import mapped
from logs.mcap_format import time_ns
from logs.protobuf import CODECS, decode, message_name
from logs.records import Record, RunEnd

if TYPE_CHECKING:
    from logs.validate_container import Contents
    from logs.validate_inputs import Inputs

__all__ = ["Finding", "OnProgress", "Report", "validate"]

OnProgress = Callable[[float], None]

_CONTAINER = 0.3  # share of step 1 in the work
_TELL_EVERY = 1000  # messages


def validate(path: Path, *, on_progress: OnProgress | None = None) -> Report:
    """Check a log.

    Args:
        path: of an MCAP file.
        on_progress: told now and then which share of the work is done, 0 … 1.

    Returns:
        The findings; none for a good log.

    Raises:
        LogError: there is no such file, or nothing of it can be read as a log.
    """
    begun = time.perf_counter()
    checks = Checks()
    _validate(mapped(Path(path)), str(path), checks, on_progress or _silent)
    return Report(
        path=str(path),
        findings=checks.findings(),
        rules=dict(checks.rules),
        skipped=tuple(checks.skipped),
        seconds=time.perf_counter() - begun,
    )


def _silent(_share: float) -> None:
    """Tell nobody."""


def _validate(data: memoryview, name: str, checks: Checks, tell: OnProgress) -> None:
    from logs.validate_container import ContainerWalk
    from logs.validate_inputs import check_inputs, check_parts, read_inputs
    from logs.validate_summary import check_summary

    walk = ContainerWalk(data, name, checks)
    contents = walk.contents
    whole, inputs = False, None
    with _reader(checks, 1):
        whole = walk.run(lambda share: tell(_CONTAINER * share))
        if whole:
            check_summary(data, walk.summary, contents, checks)
        check_parts(contents, walk.sha256, checks)
    with _reader(checks, 1):
        inputs = read_inputs(contents, checks)
    if inputs is None:
        checks.skip("steps 2 to 4: the log does not carry all that a run is made from")
        return
    with _reader(checks, 2):
        check_inputs(inputs, contents, checks)
    if not whole or not contents.unpacked:
        checks.skip("steps 3 and 4: parts of the run are missing from the file")
        return
    with _reader(checks, 3):
        _check_run(contents, inputs, checks, tell)


def _check_run(contents: Contents, inputs: Inputs, checks: Checks, tell: OnProgress) -> None:
    """Steps 3 and 4, in one pass over the records."""
    from logs.validate_context import Context
    from logs.validate_kpi import KpiCheck
    from logs.validate_run import RunCheck
    from worlds.scene import Scene

    try:
        context = Context.of(inputs, checks, _last_slot(contents))
    except ValueError as error:
        checks.find(2, "page6:inputs", error, "a problem and plan of this world")
        checks.skip(f"steps 3 and 4: {error}")
        return
    with Scene.of(inputs.world, inputs.floor) as scene:
        run, kpis, records = RunCheck(context, scene), KpiCheck(context), 0
        total = contents.counts.total()
        for number, (channel, schema, message) in enumerate(contents.messages()):
            if number % _TELL_EVERY == 0:
                tell(_CONTAINER + (1.0 - _CONTAINER) * number / total)
            if schema not in CODECS:
                continue
            try:
                record = decode(schema, bytes(message.data))
            except LogError:
                continue  # found in step 1
            records += 1
            _check_envelope(record, channel.topic, message.log_time, checks)
            if run.add(record):
                with _reader(checks, 4):
                    kpis.add(record)
        for rule in ("container:time", "container:topic"):
            checks.count(1, rule, records)
        run.finish()
        with _reader(checks, 4):
            kpis.finish()


def _last_slot(contents: Contents) -> int | None:
    """The slot RunEnd names, None without one: how long the run is said to have lasted."""
    found = None
    for _, schema, message in contents.messages():
        if schema == message_name(RunEnd):
            with suppress(LogError):
                end = decode(schema, bytes(message.data))
                found = end.slot if isinstance(end, RunEnd) and end.slot >= 0 else found
    return found


def _check_envelope(record: Record, topic: str, log_time: int, checks: Checks) -> None:
    """A record lies on its topic, at its time."""
    name = type(record).__name__
    if not math.isfinite(record.t_s) or time_ns(record.t_s) != log_time:
        checks.find(
            1, "container:time", f"{name} of {record.t_s} s at {log_time} ns", "its own time"
        )
    own = record.topic
    if "{" in own:
        own = own.format(robot=getattr(record, "robot", ""), ap=getattr(record, "ap", ""))
    if own != topic:
        checks.find(1, "container:topic", f"{name} on topic {topic}", own)


@contextmanager
def _reader(checks: Checks, step: int) -> Iterator[None]:
    """Whatever a forged file provokes is a finding, never a traceback."""
    try:
        yield
    except Exception as error:  # anything: that is the point
        place = traceback.extract_tb(error.__traceback__)[-1]
        checks.find(
            step,
            "reader",
            f"{type(error).__name__} in {place.name}, line {place.lineno}: {error}",
            "a log this step can go through; the rest of it was not checked",
        )
        checks.skip(f"the rest of step {step}: it met something unforeseen")
