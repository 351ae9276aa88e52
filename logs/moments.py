"""A run at any instant: where everybody is, who serves whom, what is in the way.

`moments` goes through a log once and gives the state at each of some ascending times; between two
samples positions are interpolated, all else is as the earlier one says.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from logs.errors import LogError
from logs.foxglove import log_line
from logs.mcap_format import time_ns
from logs.records import (
    LINKS,
    NO_AP,
    OUTAGE,
    Blockages,
    Disturbance,
    Record,
    RunEnd,
    RunStart,
    Sample,
)

if TYPE_CHECKING:
    from logs.mcap_reader import RunFile

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LOST = (LINKS.index(OUTAGE), LINKS.index(NO_AP))


@dataclass(frozen=True)
class Moment:
    """The run at an instant.

    Attributes:
        t_s, slot: when.
        robot: (n,) indices of the robots on the floor.
        xy_m: (n, 2) where they are [m].
        heading_rad: (n,) where they look.
        ap: (n,) index of the AP that serves each, −1 for none.
        link: (n,) index into `LINKS`.
        blockages: boxes in the way, None before the first.
        out: APs that are out.
        event: what happened last, in words, and when [s].
    """

    t_s: float
    slot: int
    robot: Ints
    xy_m: Floats
    heading_rad: Floats
    ap: Ints
    link: Ints
    blockages: Blockages | None
    out: tuple[str, ...]
    event: tuple[float, str]

    @property
    def lost(self) -> NDArray[np.bool_]:
        """(n,) whether each is without connection."""
        return np.isin(self.link, _LOST)


def run_span(run: RunFile) -> tuple[RunStart, RunEnd]:
    """The first and the last record of a run.

    Raises:
        LogError: it has none.
    """
    start: RunStart | None = None
    end: RunEnd | None = None
    for record in run.iter_records((RunStart, RunEnd)):
        start = record if isinstance(record, RunStart) else start
        end = record if isinstance(record, RunEnd) else end
    if start is None or end is None:
        raise LogError(f"{run.path}: does not tell how its run began or ended")
    return start, end


def moments(run: RunFile, times_s: Iterable[float]) -> Iterator[Moment]:
    """The run at these times, which must ascend; after the last sample, as that one says.

    Raises:
        LogError: the log is damaged.
    """
    follower = _Follower()
    blocks = _blocks(run.iter_records())
    block: list[Record] = []
    done = 0  # records of the block that are behind
    for t_s in times_s:
        while True:
            while done < len(block) and block[done].t_s <= t_s:
                follower.add(block[done])
                done += 1
            if done < len(block):
                break
            block, done = next(blocks, []), 0
            if not block:
                break
        ahead = block[-1] if block else None
        yield follower.moment(t_s, ahead if isinstance(ahead, Sample) else None)


def _blocks(records: Iterator[Record]) -> Iterator[list[Record]]:
    """Records up to a sample, that one included: what lies between two samples."""
    block: list[Record] = []
    for record in records:
        block.append(record)
        if isinstance(record, Sample):
            yield block
            block = []
    if block:
        yield block


class _Follower:
    """Keeps what holds."""

    def __init__(self) -> None:
        self._sample: Sample | None = None
        self._blockages: Blockages | None = None
        self._out: dict[str, None] = {}
        self._event = (0.0, "")

    def add(self, record: Record) -> None:
        """The next record."""
        match record:
            case Sample():
                self._sample = record
            case Blockages():
                self._blockages = record
            case Disturbance() if record.kind == "ap-outage":
                if record.begins:
                    self._out[record.ap] = None
                else:
                    self._out.pop(record.ap, None)
            case _:
                pass
        line = log_line(record, time_ns(record.t_s))
        if line is not None:
            self._event = (record.t_s, f"{line.name}: {line.message}")

    def moment(self, t_s: float, later: Sample | None) -> Moment:
        """What holds at t_s."""
        sample = self._sample
        if sample is None:
            sample = Sample(t_s, 0, *(() for _ in range(9)))
        xy = np.column_stack([sample.x_m, sample.y_m]).reshape(-1, 2).astype(np.float64)
        if later is not None and later.t_s > sample.t_s:
            share = min(max((t_s - sample.t_s) / (later.t_s - sample.t_s), 0.0), 1.0)
            there = {robot: k for k, robot in enumerate(later.robot)}
            for k, robot in enumerate(sample.robot):
                if robot in there:
                    place = later.x_m[there[robot]], later.y_m[there[robot]]
                    xy[k] += share * (np.array(place) - xy[k])
        return Moment(
            t_s=t_s,
            slot=sample.slot,
            robot=np.array(sample.robot, np.int64),
            xy_m=xy,
            heading_rad=np.array(sample.heading_rad, np.float64),
            ap=np.array(sample.ap, np.int64),
            link=np.array(sample.link, np.int64),
            blockages=self._blockages,
            out=tuple(self._out),
            event=self._event,
        )
