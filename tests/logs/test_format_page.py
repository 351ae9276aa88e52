"""docs/log-format.md is what the code does, and enough for a stranger to read a log."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

import logs
from logs.format_page import READER, declared, format_page, meanings, units
from logs.foxglove_view import TOPICS
from logs.mcap_format import ATTACHMENTS
from logs.records import RECORD_TYPES, ApLoad
from tests.logs.mcap_files import write
from tests.logs.sample_run import sample_run

PAGE = Path(__file__).resolve().parents[2] / "docs" / "log-format.md"


def test_the_page_is_up_to_date():
    """Else: `twin schema -o docs/log-format.md --overwrite`."""
    assert PAGE.read_text(encoding="utf-8") == format_page()


@pytest.mark.parametrize("record_type", RECORD_TYPES)
def test_every_field_has_a_row_a_meaning_and_its_unit(record_type):
    """Names, numbers and types are the descriptor's; names that end in a unit have it."""
    page = format_page()
    assert f"### `{record_type.topic}`" in page
    said = meanings(record_type)
    names = [name for name, _, _ in declared(record_type)]
    assert names == [field.name for field in fields(record_type)]
    for name, number, kind in declared(record_type):
        assert said[name], f"say in logs/records.py what {record_type.__name__}.{name} is"
        assert f"| `{name}` | {number} | {kind} |" in page
        if re.search(r"_(s|m|db|rad|mbps|mbit|slots)$", name):
            assert name in units(record_type)


def test_every_topic_and_attachment_is_told():
    """Those of the records, those for Foxglove, and what is attached."""
    page = format_page()
    for name in (*TOPICS, *ATTACHMENTS, *(t.topic for t in RECORD_TYPES)):
        assert f"`{name}`" in page


def test_a_stranger_can_read_a_log_with_it(tmp_path):
    """The page's reader, which knows nothing of this project, prints the loads of a run."""
    assert READER in format_page()
    script = tmp_path / "reader.py"
    script.write_text(READER)
    log = write(tmp_path / "run.mcap", sample_run(10))
    done = subprocess.run(
        [sys.executable, "-I", script, log], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.splitlines() == [
        f"{r.t_s} {r.ap} {r.load} of {r.capacity}" for r in logs.read(log).of(ApLoad)
    ]


def test_the_python_example_works(tmp_path):
    """The page's example of this project's own reader runs beside a log."""
    write(tmp_path / "run.mcap", sample_run(10))
    (example, _) = re.findall(r"^```python\n(.*?)^```$", format_page(), re.DOTALL | re.MULTILINE)
    done = subprocess.run(
        [sys.executable, "-c", example],
        cwd=tmp_path,
        env={"PYTHONPATH": str(PAGE.parents[1])},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert "connected" in done.stdout
