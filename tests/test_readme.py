"""The README is true: its commands run, its Python runs, its links lead somewhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from logs.mcap_reader import read

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
TIMEOUT_S = 600
NOT_HERE = ("make ", ". .venv/")
"""They set the environment up in which the tests run already."""


def blocks(language: str) -> list[str]:
    """The fenced code blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)


def commands() -> list[str]:
    """The shell commands of the README, in order."""
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    return [line for line in lines if line.strip() and not line.startswith(NOT_HERE)]


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """An empty folder with the worlds that ship, and `twin` on the PATH of its shell."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "worlds").mkdir()
    for world in [*(ROOT / "worlds").glob("*.toml"), *(ROOT / "worlds").glob("*.json")]:
        shutil.copy(world, folder / "worlds")
    return folder


def environment(folder: Path) -> dict[str, str]:
    """The test's own interpreter first on the PATH, and the `twin` installed beside it.

    Where the project is not installed (its folder is only on the Python path), a file of that name
    stands for the command.
    """
    paths = [str(Path(sys.executable).parent), os.environ["PATH"]]
    if shutil.which("twin", path=paths[0]) is None:
        command = folder / "bin" / "twin"
        command.parent.mkdir(exist_ok=True)
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m twin.cli "$@"\n')
        command.chmod(0o755)
        paths.insert(0, str(command.parent))
    return os.environ | {"PATH": os.pathsep.join(paths), "PYTHONPATH": str(ROOT)}


def run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder."""
    return subprocess.run(
        command,
        cwd=folder,
        env=environment(folder),
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )


def test_every_command_works(place):
    """All shell commands, in the README's order, in an empty folder: exit 0 and a quiet stderr."""
    listed = commands()
    assert len(listed) >= 8
    for command in listed:
        done = run(["bash", "-c", command], place)
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        assert done.stderr == "", command


def test_the_python_example_works(place):
    """The library example runs and prints the run's sentence."""
    (example,) = blocks("python")
    done = run([sys.executable, "-c", example], place)
    assert done.returncode == 0, done.stderr
    assert "log validated" in done.stdout


def test_the_what_if_says_what_happens(place):
    """Handovers and slots of the three runs are those that the README tells."""
    if not (place / "runs/more-power/run.mcap").exists():
        pytest.skip("the commands were not run")
    figures = {}
    for folder in ("tiny", "moved-west", "more-power"):
        plan = read(place / "runs" / folder / "run.mcap").plan
        figures[folder] = (plan.handovers, plan.slots)
    assert figures == {"tiny": (2, 35), "moved-west": (0, 39), "more-power": (0, 35)}
    assert "change the access point twice" in TEXT
    assert "39 slots instead of 35" in TEXT


def test_links_lead_somewhere():
    """Every relative link and picture of the README exists."""
    targets = re.findall(r"\]\(([^)#:]+)\)", TEXT)
    assert len(targets) >= 6
    assert [t for t in targets if not (ROOT / t).exists()] == []


def test_it_starts_with_a_sentence_and_a_picture():
    """The first screen says what it is and shows it."""
    head = TEXT[: TEXT.index("\n## ")]
    assert re.search(r"!\[[^\]]+\]\(docs/paper_hall\.png\)", head)
    assert (ROOT / "docs/paper_hall.png").read_bytes().startswith(b"\x89PNG")


def test_make_targets_exist():
    """The two set-up commands are targets of the Makefile."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^make (\w+)$", TEXT, re.MULTILINE):
        assert f"\n{target}:" in makefile
