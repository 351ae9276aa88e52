"""Step 5 of validation: the run made again from the inputs in its log, message by message.

The twin promises that equal inputs give equal records (page 6). `rerun` takes world, radio map,
problem and plan out of a log, executes the plan again, and holds every message that comes of it
against the one in the log: the records and what Foxglove is shown of them. Nothing is kept but the
two messages in hand, so logs larger than the memory are no matter. `rerun_elsewhere` does it in
another process whose strings hash otherwise, so that an order that hangs on hashing shows.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from logs.errors import LogError
from logs.findings import Finding, Report
from twin.errors import TwinError

if TYPE_CHECKING:
    from logs.foxglove_view import Out
    from logs.mcap_reader import Message, RunFile
    from logs.messages import MessageStream
    from logs.records import Record, Sample

STEP = 5
RULE = "page6:replay"
OnProgress = Callable[[float], None]

_FAILED = 3  # exit code of the other process: it says why on stdout
_SHOWN = 160  # characters of a value that are shown


@dataclass(frozen=True)
class Difference:
    """The first thing that is not the same.

    Attributes:
        slot: in which, None if it is not known.
        t_s: simulated time [s].
        record: the kind of record, or the topic of a Foxglove message.
        robot: whose record, "" if nobody's.
        field: of the record, "" if it is missing, superfluous or of another kind.
        found: what the log says.
        expected: what running again gives.
    """

    slot: int | None
    t_s: float
    record: str
    robot: str
    field: str
    found: str
    expected: str

    def __str__(self) -> str:
        """`slot 7, RobotState of r03, ap: "ap1" in the log, "ap2" by running again`."""
        place = f"slot {self.slot}" if self.slot is not None else f"t = {self.t_s:g} s"
        whose = f" of {self.robot}" if self.robot else ""
        part = f", {self.field}" if self.field else ""
        return (
            f"{place}, {self.record}{whose}{part}: {self.found} in the log, "
            f"{self.expected} by running again"
        )


@dataclass(frozen=True)
class Rerun:
    """The answer of a rerun.

    Attributes:
        messages: how many were held against each other; all of them if there is no difference.
        difference: the first one, None if the run is the same.
        seconds: wall-clock time spent.
    """

    messages: int
    difference: Difference | None
    seconds: float


class _Stop(Exception):  # noqa: N818  (no error: the answer is known)
    """Ends a run at the first difference."""


def rerun(path: Path, *, on_progress: OnProgress | None = None) -> Rerun:
    """Run a log's inputs again and compare, in this process.

    Args:
        path: of the log.
        on_progress: told now and then which share of the work is done, 0 … 1.

    Raises:
        LogError: the log cannot be read, or lacks an input.
        TwinError: its inputs are none that can be run.
    """
    from logs.mcap_reader import read
    from logs.messages import MessageStream
    from twin.twin import run

    begun = time.perf_counter()
    file = read(path)
    inputs = (file.world, file.floor, file.radio_map, file.problem, file.plan)
    comparison = _Comparison(file, MessageStream(*inputs))

    def on_slot(done: int, total: int) -> None:
        if on_progress:
            on_progress(done / total)

    try:
        run(*inputs, emit=comparison.add, on_slot=on_slot)
        comparison.finish()
    except _Stop:
        pass
    except (LogError, TwinError):
        raise
    except Exception as error:  # inputs that no plan and no world would give, forged
        text = f"{type(error).__name__}: {error}"
        raise TwinError(f"{path}: its inputs cannot be run again: {text}") from error
    seconds = time.perf_counter() - begun
    return Rerun(comparison.messages, comparison.difference, seconds)


def rerun_elsewhere(path: Path, *, hash_seed: int, on_progress: OnProgress | None = None) -> Rerun:
    """Run a log's inputs again and compare, in another process.

    Args:
        path: of the log.
        hash_seed: of its strings (PYTHONHASHSEED), 0 … 4294967295.
        on_progress: told now and then which share of the work is done, 0 … 1.

    Raises:
        TwinError: the log cannot be read or run again, or the process has died.
    """
    root = str(Path(__file__).resolve().parents[1])
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {
        "PYTHONHASHSEED": str(hash_seed),
        "PYTHONPATH": os.pathsep.join(paths),
    }
    command = [sys.executable, "-m", "twin.rerun", str(path)]
    answer: dict[str, Any] = {}
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
        text=True,
        encoding="utf-8",
    ) as process:
        try:
            for line in process.stdout or ():
                answer = json.loads(line)
                if "share" in answer and on_progress:
                    on_progress(answer["share"])
        except BaseException:
            process.kill()
            raise
    if "error" in answer:
        raise TwinError(answer["error"])
    if process.returncode or "messages" not in answer:
        raise TwinError(
            f"{path}: the process that ran it again ended with code {process.returncode}; "
            "is there enough memory?"
        )
    told = answer["difference"]
    return Rerun(answer["messages"], Difference(**told) if told else None, answer["seconds"])


def with_rerun(report: Report, answer: Rerun) -> Report:
    """A validator's report with step 5 added."""
    findings, different = report.findings, answer.difference
    if different is not None:
        part = f"{different.record} at {different.t_s:.9g} s"
        part += f", {different.field}" if different.field else ""
        found = f"{part}: {different.found}"
        expected = f"{different.expected}, by running its inputs again"
        finding = Finding(STEP, RULE, different.slot, different.robot, found, expected)
        findings = (*findings, finding)
    rules = {**report.rules, (STEP, RULE): answer.messages}
    seconds = report.seconds + answer.seconds
    return replace(report, findings=findings, rules=rules, seconds=seconds)


def without_rerun(report: Report, reason: str) -> Report:
    """A validator's report that says why step 5 could not be done."""
    rules = {**report.rules, (STEP, RULE): 0}
    return replace(report, rules=rules, skipped=(*report.skipped, f"step 5: {reason}"))


# --- comparing ------------------------------------------------------------------------------------


class _Comparison:
    """Holds each message of a new run against the next one of a log.

    Attributes:
        messages: how many were compared.
        difference: the first one met.
    """

    def __init__(self, file: RunFile, stream: MessageStream) -> None:
        self.messages = 0
        self.difference: Difference | None = None
        self._told: Iterator[Message] = file.iter_messages()
        self._stream = stream
        self._slot_s = 0.0
        self._robots: tuple[str, ...] = ()

    def add(self, record: Record) -> None:
        """The next record of the new run.

        Raises:
            _Stop: something is different.
        """
        from logs.records import RunStart

        if isinstance(record, RunStart):
            self._slot_s, self._robots = record.slot_s, record.robots
        for expected in self._stream.of(record):
            told = next(self._told, None)
            self.messages += 1
            if told is None or (told.topic, told.log_time_ns, told.data) != expected:
                self.difference = self._differs(told, expected)
                raise _Stop

    def finish(self) -> None:
        """The new run is over; so should be the log."""
        more = next(self._told, None)
        if more is not None:
            self.difference = self._differs(more, None)

    def _differs(self, told: Message | None, expected: Out | None) -> Difference:
        from logs.mcap_format import time_s
        from logs.records import Sample

        old = self._decode(told.topic, told.data, told.schema) if told else None
        new = None
        if expected is not None:
            new = self._decode(expected[0], expected[2], self._stream.channels[expected[0]].name)
        topic, time_ns = (expected[0], expected[1]) if expected else ("", 0)
        if told is not None and expected is None:
            topic, time_ns = told.topic, told.log_time_ns
        t_s = time_s(time_ns)
        subject = new if new is not None else old
        kind = type(subject).__name__ if subject is not None else topic
        slot = getattr(subject, "slot", None)
        if slot is None and self._slot_s > 0:
            slot = int(t_s / self._slot_s + 1e-9)
        field, robot = "", getattr(subject, "robot", "")
        robot = robot if isinstance(robot, str) else ""
        if told is None:
            found, wanted = "nothing", "one more message"
        elif expected is None:
            found, wanted = "one message more", "the end of the run"
        elif old is not None and type(old) is type(new):
            field, found, wanted, index = _first_field(old, new)
            if index is not None and isinstance(new, Sample):
                robot = self._robot_of(new, index)
        elif told.topic != expected[0]:
            found, wanted = f"a message on {told.topic}", f"one on {topic}"
        elif told.log_time_ns != expected[1]:
            found, wanted = f"at {time_s(told.log_time_ns):.9g} s", f"at {t_s:.9g} s"
        else:
            found = f"{len(told.data)} bytes"
            wanted = f"others ({len(expected[2])} bytes)"
        return Difference(slot, t_s, kind, robot, field, found, wanted)

    def _decode(self, topic: str, data: bytes, schema: str) -> Record | None:
        """The record in a message, None if it holds none."""
        from logs.protobuf import CODECS, decode

        if schema not in CODECS:
            return None
        try:
            return decode(schema, data)
        except LogError:
            return None

    def _robot_of(self, sample: Sample, index: int) -> str:
        """Whose entry of a sample that is."""
        if index < len(sample.robot) and 0 <= sample.robot[index] < len(self._robots):
            return self._robots[sample.robot[index]]
        return ""


def _first_field(old: Any, new: Any) -> tuple[str, str, str, int | None]:
    """The first field in which two records of a kind differ: name, both values, entry."""
    for field in fields(old):
        found, wanted = getattr(old, field.name), getattr(new, field.name)
        if _same(found, wanted):
            continue
        if isinstance(found, tuple) and len(found) == len(wanted):
            pairs = enumerate(zip(found, wanted, strict=True))
            k = next(k for k, (a, b) in pairs if not _same(a, b))
            return f"{field.name}[{k}]", _shown(found[k]), _shown(wanted[k]), k
        return field.name, _shown(found), _shown(wanted), None
    return "", "other bytes", "those of an equal record", None


def _same(a: object, b: object) -> bool:
    """Equal, and equal as written: 0.0 is not −0.0, and NaN is NaN."""
    return repr(a) == repr(b)


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return f"{len(value)} entries"
    text = json.dumps(value) if isinstance(value, str) else repr(value)
    return text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…"


# --- the other process ----------------------------------------------------------------------------


def _main(path: str) -> int:
    """Run a log again and tell of it on stdout, one JSON object per line."""
    told = -1

    def on_progress(share: float) -> None:
        nonlocal told
        if int(100 * share) > told:
            told = int(100 * share)
            print(json.dumps({"share": share}), flush=True)

    try:
        answer = rerun(Path(path), on_progress=on_progress)
    except Exception as error:
        print(json.dumps({"error": str(error) or type(error).__name__}), flush=True)
        return _FAILED
    print(json.dumps(asdict(answer)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1]))
