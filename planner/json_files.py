"""problem.json and plan.json, the planner's own files (1-semantics, last two sections)."""

from __future__ import annotations

from pathlib import Path

from planner.errors import PlannerError
from planner.json_plan import dump_plan, parse_plan
from planner.json_problem import dump_problem, parse_problem
from planner.plan import Plan
from planner.problem import Problem

__all__ = ["dump_plan", "dump_problem", "parse_plan", "parse_problem", "read_plan", "read_problem"]


def read_problem(path: Path) -> Problem:
    """The problem in a problem.json file.

    Raises:
        PlannerError: with all faults of the file at once.
    """
    return parse_problem(_text_of(path), path.name)


def read_plan(path: Path, problem: Problem) -> Plan:
    """The plan in a plan.json file, for the problem it belongs to.

    Raises:
        PlannerError: with all faults of the file at once.
    """
    return parse_plan(_text_of(path), problem, path.name)


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise PlannerError(
            f"{path.name}: byte {error.start}: not UTF-8; save the file as UTF-8"
        ) from error
    except OSError as error:
        raise PlannerError(f"{path}: cannot be read: {error.strerror or error}") from error
