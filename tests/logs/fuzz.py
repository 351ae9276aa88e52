"""Damages logs at random, and looks whether whoever reads them keeps his temper.

    python -m tests.logs.fuzz RUN.mcap --count 2000

Half of the files are damaged byte by byte; in the other half the damage lies within chunks or
attachments and all CRCs are made to fit, so that it comes through to those who read the contents.
"""

from __future__ import annotations

import argparse
import resource
import struct
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode

import logs
from logs.container import MAGIC, parse, pieces, unpack_chunk
from logs.diff import diff
from logs.errors import LogError
from logs.records import Sample
from logs.report import report_html
from logs.validate import validate

Rng = np.random.Generator

READERS: dict[str, Callable[[Path, Path], object]] = {
    "validate": lambda path, good: validate(path),
    "read": lambda path, good: [*logs.read(path).iter_records()] and logs.read(path).table(Sample),
    "report": lambda path, good: report_html(logs.read(path)),
    "diff": lambda path, good: diff(logs.read(good), logs.read(path)),
}


# --- damage ---------------------------------------------------------------------------------------


def _flips(data: bytearray, rng: Rng) -> bytearray:
    for at in rng.integers(0, len(data), int(rng.integers(1, 20))):
        data[at] ^= 1 << int(rng.integers(8))
    return data


def _cut_end(data: bytearray, rng: Rng) -> bytearray:
    return data[: int(rng.integers(0, len(data)))]


def _cut_out(data: bytearray, rng: Rng) -> bytearray:
    at = int(rng.integers(0, len(data)))
    return data[:at] + data[at + int(rng.integers(1, 5000)) :]


def _splice(data: bytearray, rng: Rng) -> bytearray:
    a, b = sorted(rng.integers(0, len(data), 2).tolist())
    at = int(rng.integers(0, len(data)))
    return data[:at] + data[a : min(b, a + 50_000)] + data[at:]


def _zeros(data: bytearray, rng: Rng) -> bytearray:
    at, size = int(rng.integers(0, len(data))), int(rng.integers(1, 400))
    data[at : at + size] = bytes(len(data[at : at + size]))
    return data


def _numbers(data: bytearray, rng: Rng) -> bytearray:
    """Large and odd numbers where lengths, sizes or times may be."""
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(0, max(1, len(data) - 8)))
        value = int(rng.choice([0, 1, 255, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1]))
        data[at : at + 8] = struct.pack("<Q", value)
    return data


def _head(data: bytearray, rng: Rng) -> bytearray:
    at = int(rng.integers(0, min(200, len(data))))
    data[at] = int(rng.integers(256))
    return data


def _text(data: bytearray, rng: Rng) -> bytearray:
    """Digits and signs of texts and numbers in JSON and TOML exchanged."""
    places = [k for k, byte in enumerate(data) if 48 <= byte <= 57]
    for at in rng.choice(places, min(len(places), int(rng.integers(1, 6)))) if places else ():
        data[at] = int(rng.choice(list(b"0123456789-.e")))
    return data


RAW = (_flips, _cut_end, _cut_out, _splice, _zeros, _numbers, _head)
INNER = (_flips, _cut_end, _cut_out, _splice, _zeros, _numbers, _text)


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _string(text: str) -> bytes:
    return struct.pack("<I", len(text.encode())) + text.encode()


def _rebuilt(data: bytes, rng: Rng) -> bytes:
    """One chunk or attachment damaged, some chunks doubled or exchanged, CRCs made to fit."""
    found = []
    for piece in pieces(memoryview(data)[: -len(MAGIC)], len(MAGIC)):
        if piece.opcode == Opcode.DATA_END:
            break
        if piece.opcode != Opcode.MESSAGE_INDEX:
            found.append(piece)
    kinds = [k for k, p in enumerate(found) if p.opcode in (Opcode.CHUNK, Opcode.ATTACHMENT)]
    chosen = int(rng.choice(kinds))
    damage = INNER[int(rng.integers(len(INNER)))]
    out = []
    for k, piece in enumerate(found):
        content = bytes(piece.content)
        if piece.opcode == Opcode.CHUNK:
            chunk = parse(piece)
            inner = bytearray(unpack_chunk(chunk))
            inner = damage(inner, rng) if k == chosen else inner
            times = struct.pack("<QQ", chunk.message_start_time, chunk.message_end_time)
            content = times + struct.pack("<QI", len(inner), zlib.crc32(inner))
            content += _string("") + struct.pack("<Q", len(inner)) + bytes(inner)
        elif k == chosen:
            part = parse(piece)
            inner = damage(bytearray(part.data), rng)
            content = struct.pack("<QQ", part.log_time, part.create_time)
            content += _string(part.name) + _string(part.media_type)
            content += struct.pack("<Q", len(inner)) + bytes(inner)
            content += struct.pack("<I", zlib.crc32(content))
        out.append(_record(piece.opcode, content))
    if rng.random() < 0.15:
        at = int(rng.integers(len(out)))
        out.insert(int(rng.integers(len(out))), out[at])
    body = MAGIC + b"".join(out)
    end = _record(Opcode.DATA_END, struct.pack("<I", 0))
    footer = _record(Opcode.FOOTER, struct.pack("<QQI", 0, 0, 0))
    return body + end + footer + MAGIC


def damaged(data: bytes, seed: int) -> bytes:
    """The damaged file of that number."""
    rng = np.random.default_rng([seed, 20240101])
    if seed % 2:
        return _rebuilt(data, rng)
    return bytes(RAW[int(rng.integers(len(RAW)))](bytearray(data), rng))


# --- looking --------------------------------------------------------------------------------------


def outcome(reader: str, path: Path, good: Path) -> str:
    """What a reader makes of a file: "fine", "refused", or the exception nobody should see."""
    try:
        READERS[reader](path, good)
    except LogError:
        return "refused"
    except Exception as error:  # that is what is looked for
        return f"{type(error).__name__}: {traceback.format_exc()[-600:]}"
    return "fine"


def main() -> None:
    """Damage a log many times and tell what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    data = options.log.read_bytes()
    told: Counter[tuple[str, str]] = Counter()
    slowest: dict[str, tuple[float, int]] = {}
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "f.mcap"
        for seed in range(options.first, options.first + options.count):
            path.write_bytes(damaged(data, seed))
            for reader in READERS:
                begun = time.perf_counter()
                said = outcome(reader, path, options.log)
                seconds = time.perf_counter() - begun
                slowest[reader] = max(slowest.get(reader, (0.0, 0)), (seconds, seed))
                if said not in {"fine", "refused"}:
                    bad += 1
                    print(f"--- {reader}, file {seed}\n{said}", flush=True)
                    said = "traceback"
                told[reader, said] += 1
    for (reader, said), count in sorted(told.items()):
        print(f"{reader:9} {said:9} {count}")
    for reader, (seconds, seed) in slowest.items():
        print(f"slowest {reader}: {seconds:.2f} s (file {seed})")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{bad} tracebacks; at most {memory:.0f} MB of memory")


if __name__ == "__main__":
    main()
