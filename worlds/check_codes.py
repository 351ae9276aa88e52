"""The findings of `twin check`: what each code means, why it matters, and what helps.

One table; the messages, `twin check --explain` and docs/check-codes.md are made from it.
"""

from __future__ import annotations

from dataclasses import dataclass

from worlds.errors import Fault, WorldError
from worlds.part import nearest

SEVERITIES = {"E": "error", "W": "warning", "N": "note"}
"""By the first letter of a code. Errors: the world cannot be run. Warnings: it can, but is likely
not what was meant or will disappoint. Notes: worth knowing."""


@dataclass(frozen=True)
class Code:
    """What a code stands for.

    Attributes:
        title: in a few words.
        why: what it means, when it is given, and why it matters.
        mend: what to do about it.
    """

    title: str
    why: str
    mend: str


CODES: dict[str, Code] = {
    "E100": Code(
        "the world cannot be used as it is",
        "Reading the layout or casting its rays failed for a reason that has no code of its own.",
        "Do as the message says.",
    ),
    "E101": Code(
        "access point outside the hall",
        "Its x or y is beyond the walls. Often the unit is millimetres, or another origin is meant:"
        " (0, 0) is the lower left corner of the hall.",
        "Correct `position_m`.",
    ),
    "E102": Code(
        "access point inside an obstacle",
        "A ray that starts in a box sees nothing; obstacles are 2 mm larger for rays than drawn, "
        "and larger by `radio.clearance_m`, so at the very face is inside as well.",
        "Move it, hang it higher than the obstacle, or correct the obstacle's height.",
    ),
    "E103": Code(
        "obstacle outside the hall",
        "No part of its footprint lies within the walls, so it can have no effect; its place is "
        "likely a mistake.",
        "Correct `center_m` or `size_m`, or take it out.",
    ),
    "E104": Code(
        "station outside the grid",
        "A station is a position of the grid: a cell that exists, or metres within half a pitch of "
        "one.",
        "Correct `cell` or `at_m`; cells count from 0.",
    ),
    "E105": Code(
        "robot's place outside the grid",
        "Its start or goal is a cell that does not exist, or metres beyond the grid.",
        "Correct the place; cells count from 0.",
    ),
    "E106": Code(
        "robot's place is blocked",
        "A robot standing at its start or goal, in any heading, would touch an obstacle.",
        "Take a free position, move the obstacle, or make the robots smaller.",
    ),
    "E107": Code(
        "robot's place without coverage",
        "No access point reaches the start or goal with the SNR of `radio.threshold_db`; the graph "
        "holds only covered positions.",
        "Move the place, or add an access point, gain or power. `twin radio` shows where coverage "
        "ends and what blocks it.",
    ),
    "E108": Code(
        "two robots at one place",
        'Starts must differ. Goals must differ if robots stay there (`at_goal = "park"`).',
        "Give each robot its own place.",
    ),
    "E109": Code(
        "goal cut off from the start",
        "Obstacles leave no free way from start to goal, whatever the radio and the other robots.",
        "Open a gap, choose another goal, or make the robots narrower: a way counts as free if the "
        "strip a body sweeps touches nothing.",
    ),
    "E110": Code(
        "goal cut off by the radio",
        "There is a free way, but each leads through positions or edges without coverage, or where "
        "no handover is possible.",
        "Close the hole with an access point, or use another goal.",
    ),
    "E111": Code(
        "goal farther than the horizon",
        "Alone in the hall, on the shortest covered way, the robot would need more slots than "
        "`plan.horizon`: no plan can exist.",
        "Raise `plan.horizon` well above the distance, to leave room for waiting.",
    ),
    "E112": Code(
        "robots too large for the grid",
        "At a corner two robots following each other come within pitch/√2, so the body must not be "
        "wider; at neighbouring positions they are a pitch apart, so it must be shorter.",
        "Raise `pitch_m`, or correct the body.",
    ),
    "E113": Code(
        "no free position",
        "At each position of the grid a robot would touch an obstacle.",
        "Use a smaller pitch or body, or check the obstacles' sizes for their unit.",
    ),
    "E114": Code(
        "no robots, or no room for them",
        "The world names no robot, or draws more than the largest connected and covered part of "
        "the floor has positions.",
        "List robots, draw fewer, or give more floor or coverage.",
    ),
    "E115": Code(
        "no access point is on",
        "Robots must be served in every slot.",
        "Add an `[[ap]]`, or set `enabled = true`.",
    ),
    "E116": Code(
        "no position is covered",
        "No access point reaches any free position with the SNR of `radio.threshold_db`.",
        "Check heights, `tx_power_dbm`, gains and `frequency_ghz`; or lower the threshold.",
    ),
    "E117": Code(
        "capacity below the fleet",
        "In slot 0 every robot is served, so the capacities of the access points that are on must "
        "add up to the number of robots at least.",
        "Raise `ap_capacity` (or an AP's `capacity`), add an access point, or take fewer robots.",
    ),
    "E118": Code(
        "robots' places overload the access points",
        "The total capacity suffices, but the robots stand (at their starts; under `park` also at "
        "their goals) where too few access points reach them to serve all at once.",
        "Spread the places, or give the access points there more capacity or a neighbour.",
    ),
    "E119": Code(
        "goal not reachable along the lanes",
        "There are lanes between start and goal, but one-way ones that lead the other way: nobody "
        "gets from the one to the other.",
        "Add a lane, make one two-way by an edge back, or choose another goal.",
    ),
    "W101": Code(
        "station is blocked",
        "A robot could not stand there without touching an obstacle. No robot uses it yet.",
        "Move the station or the obstacle.",
    ),
    "W102": Code(
        "station without coverage",
        "No access point reaches the station, so no robot can start or end there. None does yet.",
        "Move the station, or add coverage.",
    ),
    "W103": Code(
        "floor cut off by one blocked cell",
        "Free positions that a single blocked cell separates from the largest connected part. "
        "Often one obstacle stands a hand's breadth too far out, or a map has a speck there.",
        "Look at the marked cells: free them, or ignore this if the places behind are not needed.",
    ),
    "W104": Code(
        "unreachable share of the floor",
        "More than 2 % of the free positions are not connected with the largest part: no robot "
        "gets there.",
        "Open a way, use a smaller pitch or body, or take the share for lost.",
    ),
    "W105": Code(
        "single passage",
        "One position is the only way to at least 5 % of the connected floor. A robot that stops "
        "there, or a pallet, cuts it off; and traffic in both directions queues.",
        "Make the passage two positions wide, or open a second way.",
    ),
    "W106": Code(
        "bodies can touch at corners",
        "Length + width is more than the pitch. A robot turning off a corner and the next one "
        "arriving at it may then overlap on the way, though their positions never do.",
        "Keep length + width ≤ pitch; or watch the minimum separation in the report of a run.",
    ),
    "W107": Code(
        "crowded floor",
        "Robots take more than 40 % of the connected positions. Plans get long, and are hard to "
        "find.",
        "Take fewer robots, or a smaller pitch if their size allows.",
    ),
    "W108": Code(
        "horizon is tight",
        "Some robot needs more than 80 % of `plan.horizon` even if it is alone: little room is "
        "left for waiting and detours.",
        "Raise `plan.horizon`; a larger horizon costs planning time only.",
    ),
    "W109": Code(
        "node that cannot be left or entered",
        "One-way lanes only lead to it, or only away from it. A robot that drives to the one never "
        "comes back; the other is of use as a start only.",
        "Add the missing edge to the LIF file or the graph.",
    ),
    "W110": Code(
        "nodes that can only be entered, or only be left",
        "Several nodes hang together, but one-way lanes only lead into them, or only out.",
        "Add the missing edge to the LIF file or the graph.",
    ),
    "W111": Code(
        "lane blocked by an obstacle",
        "The strip a robot sweeps on the lane, half its length beyond both ends, touches an "
        "obstacle. The lane is left out of the graph, and a node without a free lane with it.",
        "Check `offset_m` of the graph, the obstacle and the body.",
    ),
    "W112": Code(
        "nodes nearer than a body",
        "Robots standing at both at the same time touch each other, in a heading that a lane gives "
        "them. The rules of a plan keep robots apart at one node, not at two.",
        "Make one node of the two, move them apart, or use smaller robots.",
    ),
    "W113": Code(
        "lanes that cross, or run too near each other",
        "Lanes without a common node whose swept strips overlap. Nothing in a plan keeps robots on "
        "them apart; a run reports the contact.",
        "Put a node where the lanes cross, or draw them further apart.",
    ),
    "W114": Code(
        "robots following each other touch",
        "A node may be entered in the slot in which the robot before leaves it. Where that one "
        "moves less than a body's length in a slot, or turns off at a sharp angle, the two touch; "
        "a run reports the contact.",
        "Take a longer `hall.slot_s`, faster lanes or smaller robots.",
    ),
    "W115": Code(
        "layout taken otherwise than it may be meant",
        "Something the LIF file says is not known here or is simplified: trajectories are driven "
        "straight, load restrictions are not heeded, edges to other layouts are left out.",
        "See whether it matters for what you ask of the twin.",
    ),
    "W116": Code(
        "slots too long for the lanes",
        "A lane takes whole slots. Rounding up makes the lanes together more than 25 % slower than "
        "they are.",
        "Try another `hall.slot_s`; a shorter one costs planning time.",
    ),
    "W201": Code(
        "access point covers nothing",
        "Not one free position reaches the threshold at this access point.",
        "Check its place, height, power and channel model; or take it out.",
    ),
    "W202": Code(
        "access point is not needed for coverage",
        "Each position it covers is covered by another one too, and the others' capacity suffices "
        "for the fleet. It still gives redundancy.",
        "Move it to where coverage or a second access point is missing, or keep it as a reserve.",
    ),
    "W203": Code(
        "no redundancy",
        "More than 10 % of the covered positions are covered by one access point only: its failure "
        "leaves a hole there.",
        "Add an access point, or hang them so that they overlap. `twin radio` draws k-coverage.",
    ),
    "W204": Code(
        "positions without coverage",
        "Robots cannot use them: they are not in the planner's graph.",
        "Move or add an access point. The message names what is most often in the way.",
    ),
    "W205": Code(
        "edges that hide a hole",
        "Both ends are covered, but somewhere between them coverage breaks. With `edge_rule = "
        '"endpoints"` robots drive through such holes without noticing; with `"samples"` the edge '
        "is not used.",
        'Use `edge_rule = "samples"`; and close the hole if the edges matter.',
    ),
    "W206": Code(
        "coverage splits the floor",
        "More than 1 % of the covered positions hang together with the largest part on the floor, "
        "but not within coverage.",
        "Close the hole between them.",
    ),
    "W207": Code(
        "capacity fails with one access point",
        "Without the access point of largest capacity the others' capacity is below the fleet.",
        "Leave spare capacity if the fleet is to survive the loss of an access point.",
    ),
    "W208": Code(
        "access point at the height of the robots",
        "It hangs no higher than the robots' antennas, where every obstacle is in the way. Often "
        "the third coordinate was forgotten or is in another unit.",
        "Give its height above the floor as the third number of `position_m`.",
    ),
    "W209": Code(
        "beyond the range of the channel model",
        "Positions whose best access point is farther away than the distances the model was made "
        "for (150 m for InH, 600 m for InF).",
        "Take the SNR there with caution; use an InF model for large halls.",
    ),
    "W210": Code(
        "positions without measurements",
        "The survey (`radio.measured`) has too few measurements near some positions. What stands "
        "in is said by `gaps`: the channel model, or no signal.",
        "Measure there, widen `radius_m`, or lower `min_samples`.",
    ),
    "W211": Code(
        "measurements far from the model",
        "An access point is measured more than 10 dB better or worse than the model on average. "
        "Often two access points are mixed up, or power or place are not those of the hall.",
        "Compare with `twin radio --compare`; correct the access point, or set its `offset_db`.",
    ),
    "W301": Code(
        "looks like millimetres",
        "A length is far beyond what halls, robots and shelves measure, and plausible if it were "
        "millimetres (or centimetres).",
        "All lengths are metres.",
    ),
    "W302": Code(
        "implausible speed",
        "A robot covers a pitch per slot, and that is faster than 5 m/s or slower than 2 cm/s.",
        "Check `slot_s` or `speed_m_s`; a slot lasts pitch / speed seconds.",
    ),
    "W303": Code(
        "obstacle inside another",
        "An obstacle lies wholly within another one: it changes nothing and is likely a copy.",
        "Take it out, or correct its place.",
    ),
    "W304": Code(
        "obstacle above everything",
        "Its underside is higher than all access points: it blocks neither robots nor rays.",
        "Check `base_m`; it is the height of the underside above the floor.",
    ),
    "N101": Code(
        "station is not used",
        "No robot starts or ends there.",
        "Nothing to do; a spelling mistake would be an error.",
    ),
    "N102": Code(
        "access point is off",
        "It has `enabled = false` and takes no part.",
        "Nothing to do, if that is meant.",
    ),
    "N103": Code(
        "goal shared by robots",
        'Under `at_goal = "leave"` several robots may have the same goal; they arrive one after '
        "the other.",
        "Nothing to do, if that is meant.",
    ),
}


def severity(code: str) -> str:
    """`error`, `warning` or `note`."""
    return SEVERITIES[code[0]]


def known_code(text: str) -> str:
    """The code that is meant, in its own spelling.

    Raises:
        WorldError: there is none of that name.
    """
    code = text.strip().upper()
    if code not in CODES:
        hint = nearest(code, list(CODES)).strip() or "docs/check-codes.md lists them"
        message = f"'{text.strip()}' is no code of a finding; {hint}"
        raise WorldError([Fault((), message)])
    return code


def parse_codes(text: str) -> tuple[str, ...]:
    """`W103,N101` → ("W103", "N101"), without repetitions.

    Raises:
        WorldError: with every code that there is none of, or that is an error's.
    """
    found: dict[str, None] = {}
    faults: list[Fault] = []
    for word in filter(None, (part.strip() for part in text.split(","))):
        try:
            code = known_code(word)
        except WorldError as error:
            faults += error.faults
            continue
        if severity(code) == "error":
            rule = f"{code} ({CODES[code].title}) cannot be ignored: no run would be possible"
            faults.append(Fault((), rule))
        found[code] = None
    if faults:
        raise WorldError(faults)
    return tuple(found)


def codes_page() -> str:
    """docs/check-codes.md."""
    lines = [
        "# Findings of `twin check`",
        "",
        "<!-- Made from worlds/check_codes.py by `twin schema -o docs/check-codes.md`. -->",
        "",
        "`twin check WORLD.toml` looks for what is wrong or unwise in a layout before any result",
        "of it is believed. Each finding has a code.",
        "",
        "- **Errors** (E): the world cannot be run, or no plan can exist. Exit code 1.",
        "- **Warnings** (W): it can be run, but is likely not what was meant, or will disappoint.",
        "  Exit code 0; with `--strict` 1.",
        "- **Notes** (N): worth knowing.",
        "",
        "Silence what is meant with `--ignore W103,N101`; errors cannot be ignored. With",
        "`--explain W103` it prints an entry of this page, `-o check.png` draws where the findings",
        "are, `--json` gives them to programs. A file that is not a world at all is refused with",
        "exit code 2, all its mistakes at once, each with its line.",
    ]
    for letter, name in SEVERITIES.items():
        lines += ["", f"## {name.capitalize()}s"]
        for code, entry in CODES.items():
            if code[0] == letter:
                lines += ["", f"### {code}: {entry.title}", "", entry.why, "", f"*{entry.mend}*"]
    return "\n".join(lines) + "\n"
