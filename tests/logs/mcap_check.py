"""The independent reader of `shared/tools/mcap-check`: web viewers' own package, in JavaScript.

To have it run: copy that folder, `npm install` in the copy, and set MCAP_CHECK to it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

NEAR = Path(__file__).resolve().parents[3] / "shared/tools/mcap-check"


def folder() -> Path:
    """Where it is installed; skips the test, with the reason, where it is not."""
    found = Path(os.environ.get("MCAP_CHECK", NEAR))
    if shutil.which("node") is None:
        pytest.skip("node is not installed, so mcap-check cannot run")
    if not (found / "node_modules").is_dir():
        pytest.skip(
            f"no mcap-check with node_modules at {found}: copy shared/tools/mcap-check, run "
            "`npm install` in the copy, and set MCAP_CHECK to it"
        )
    return found


def assert_good(path: Path) -> None:
    """It says GOOD, without a warning."""
    done = subprocess.run(
        ["node", "read_validate.mjs", str(path)],
        cwd=folder(),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "GOOD"), done.stdout
    assert "warning" not in done.stdout
