"""The page docs/log-format.md: every topic, field and unit of a log, told from the code itself.

`twin schema -o docs/log-format.md --overwrite` writes it. What is said of a field is the comment
behind it in `logs/records.py`, so that the two cannot part.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from google.protobuf import descriptor_pb2

from logs.foxglove_view import REPEAT_S, TOPICS
from logs.mcap_format import (
    ATTACHMENTS,
    EPOCH,
    EPOCH_NS,
    FORMAT,
    HASH_METADATA,
    LAYOUT_NAME,
    PLAN_NAME,
    PROBLEM_NAME,
    RADIO_MAP_NAME,
    RUN_METADATA,
    VERSIONS_METADATA,
    WORLD_NAME,
    ContentHash,
)
from logs.protobuf import file_descriptor, message_name
from logs.records import (
    ARRIVED,
    CAUSES,
    GONE,
    HELD,
    LINKS,
    MOVING,
    RECORD_TYPES,
    WAITING,
    Record,
)

UNITS = (
    ("_robot_slots", "robots × slots"),
    ("_slots", "slots"),
    ("_rad", "rad"),
    ("_mbps", "Mbit/s"),
    ("_mbit", "Mbit"),
    ("_db", "dB"),
    ("_s", "s"),
    ("_m", "m"),
)
"""What the end of a field's name says of its unit; `slot` alone is the number of a slot."""

_TYPES = {
    descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE: "double",
    descriptor_pb2.FieldDescriptorProto.TYPE_SINT32: "sint32",
    descriptor_pb2.FieldDescriptorProto.TYPE_STRING: "string",
    descriptor_pb2.FieldDescriptorProto.TYPE_BOOL: "bool",
}

_ATTACHED = {
    WORLD_NAME: "the world, as it was run: every override and seed is in it (docs/world-format.md)",
    RADIO_MAP_NAME: "numpy arrays: SNR of every AP at every position and along every edge",
    PROBLEM_NAME: "what the planner was asked (`mapp-problem/1`)",
    PLAN_NAME: "what it answered (`mapp-plan/1`), without the seconds it took",
    LAYOUT_NAME: "the Foxglove layout, as in the file beside the log",
}

_SHOWN = {
    "/tf": "frames `world` → `hall` (which never moves) and `world` → robot id, all of them in "
    "each message; a robot that is not on the floor is not in it; at every sample",
    "/scene/static": "floor, obstacles, APs with their names and capacities, stations, the graph; "
    "at the start and every minute",
    "/scene/plan": "every path as planned, coloured by AP, a ball at each handover; as static",
    "/radio/coverage": "`snr_db` of the best AP at every position (float32, −1000 where none is "
    "free); as static",
    "/radio/best_server": "`red green blue alpha` and `ap` (uint8): the AP of highest SNR, its "
    "index in problem.json, 255 where nothing covers; as static",
    "/aps/{ap}/coverage": "`snr_db` of one AP; as static",
    "/radio/congestion": "`price` of every position in slots (float32); only if the plan has "
    "prices; as static",
    "/scene/robots": "bodies in their own frames, and how many are on the floor; when that changes",
    "/scene/links": "a line from each robot to its AP in the AP's colour, red without connection, "
    "dashed while a handover lasts; when it changes",
    "/scene/paths": "the way ahead of each robot in the colours of its APs, and in grey the one "
    "behind it; in every slot in which it changes",
    "/scene/disturbances": "blockages, APs that are out, robots that have failed or are late; when "
    "it changes",
    "/scene/events": "handovers, incidents and new plans of the last seconds, where they happened; "
    "when it changes",
    "/log": "one line per event, `name` is the robot or AP",
}

_MEANS = {
    "t_s": "when",
    "slot": "in which slot; of what is told at a slot's end, the slot that ends",
    "robot": "its id",
    "ap": "its id",
    "x_m": "place",
    "y_m": "place",
    "z_m": "height of its centre above the floor",
    "vertex": "at which, or which it left last",
    "next_vertex": "which it will reach, the same if it stands",
    "message": "in words",
    "link": "index into the list above",
    "snr_db": "at its antenna, of its serving AP; −1000 without one",
    "rate_mbps": "of data to it",
    "arrived": "whether it stands at its goal for good; of the run: how many do",
    "handovers": "that happened",
    "planned_handovers": "of the plan",
    "connected_s": "time with a connection, over all samples",
    "handover_s": "time interrupted by handovers",
    "outage_s": "time on the floor without connection",
    "worst_outage_s": "its longest single one",
    "peak_load": "most robots served at once",
    "overload_robot_slots": "robots above the capacity, summed over slots",
    "delivered_mbit": "data",
    "p10_rate_mbps": "rate that 10 % of the time is not exceeded",
    "travel_slots": "slots until arrival, or so far",
    "planned_travel_slots": "slots until arrival as planned",
    "waiting_slots": "slots it stood as planned",
    "held_slots": "slots it stood although its plan has it move",
    "unplanned_handovers": "of these, not in the plan in force",
    "ping_pongs": "handovers back to the AP left shortly before",
    "held_by_failure": "slots held because a robot has failed",
    "held_by_delay": "slots held because it is late",
    "held_by_no_path": "slots held because it has no further way",
    "held_by_blockage": "slots held because something stands where it would go",
    "held_by_connection": "slots held without connection, its released visits used up",
    "held_by_robot": "slots held because another robot must go first",
    "capacity": "robots it can serve",
    "other": "the other robot, or the blockage",
    "RunStart.world": "its name",
    "RunStart.slot_s": "length of a slot",
    "RunStart.horizon": "slots the plan may take (T)",
    "RunStart.samples_per_slot": "instants sampled in a slot, both ends included",
    "RunStart.interruption_s": "of data by a handover",
    "RunStart.threshold_db": "least SNR of a connection",
    "RunStart.policy": "who may go when: the execution policy",
    "RunStart.at_goal": "`leave` or `park`",
    "RunStart.seed": "of the run's random draws",
    "RunStart.robots": "ids, in the order that indices of robots mean",
    "RunStart.aps": "ids, in the order that indices of APs mean",
    "RunStart.ap_capacity": "robots each AP can serve",
    "Sample.robot": "index of the robot",
    "Sample.ap": "index of the serving AP, −1 for none",
    "Sample.heading_rad": "where it looks, counter-clockwise from the x axis",
    "Handover.from_ap": "the AP it leaves, empty if it had none",
    "Handover.to_ap": "the AP that serves it now",
    "Handover.end_s": "when data flow again",
    "Handover.planned": "whether the plan in force has it",
    "ApLoad.load": "robots it serves",
    "Separation.clearance_m": "between the two bodies, negative when they overlap",
    "Separation.robot_b": "the other one",
    "Incident.kind": "see above",
    "Incident.robot": "whose, empty if nobody's",
    "Incident.ap": "which, empty if none",
    "Incident.value": "see above",
    "Kpi.robots": "how many there are",
    "Kpi.arrived": "how many stand at their goals for good",
    "Kpi.incidents": "how many there were",
    "Kpi.replans": "new plans that were asked for",
    "ApKpi.mean_load": "robots served, mean over slots",
    "ApKpi.handovers_in": "robots it took over",
    "ApKpi.handovers_out": "robots it gave away",
    "RunEnd.verdict": "`completed` or `failed`",
    "RunEnd.message": "why it failed",
    "Disturbance.begins": "false when it is over",
    "Blockages.name": "of the event in the world",
    "Blockages.yaw_rad": "turn of its length, counter-clockwise from the x axis",
    "Blockages.length_m": "along that turn",
    "Blockages.width_m": "across",
    "Blockages.height_m": "from its underside to its top",
    "Replan.cost_before": "of the paths that were in force",
    "Replan.cost_after": "of the new ones",
    "NewPath.vertices": "one per state",
    "NewPath.aps": "serving AP of each state, by index",
    "NewPath.edges": "crossed from each state to the next, −1 while waiting",
    "NewPath.piece": "slots of its present crossing that are behind it",
    "Waits.robot": "index of the one that waited",
    "Waits.other": "index of the one it waited for",
    "Waits.slots": "how many",
}
"""What fields mean whose source has no comment, by name, or by record type and name."""

READER = '''\
import sys

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader

classes = {}


def decode(schema, data):
    """The message in `data`, by the descriptors in the file."""
    if schema.id not in classes:
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            pool.Add(file)
        classes[schema.id] = message_factory.GetMessageClass(
            pool.FindMessageTypeByName(schema.name)
        )
    return classes[schema.id].FromString(data)


with open(sys.argv[1], "rb") as log:
    for schema, channel, message in make_reader(log).iter_messages():
        if schema.name == "mapp.ApLoad":
            load = decode(schema, message.data)
            print(load.t_s, load.ap, load.load, "of", load.capacity)
'''
"""A reader that knows nothing of this project; a test runs it."""


def format_page() -> str:
    """The page as Markdown."""
    return "\n".join([*_head(), *_records(), *_pictures(), *_reading()]) + "\n"


def units(record_type: type[Record]) -> dict[str, str]:
    """Field → unit, as its name tells it; fields without a unit are left out."""
    found = {}
    for field in fields(record_type):
        if field.name.startswith("held_by_"):
            found[field.name] = "slots"
            continue
        for end, unit in UNITS:
            if field.name.endswith(end):
                found[field.name] = unit
                break
    return found


def meanings(record_type: type[Record]) -> dict[str, str]:
    """Field → the comment behind it in the source, or else what `_MEANS` says of it."""
    source = inspect.getsource(record_type)
    pattern = re.compile(r"^    (\w+): [^#\n]*(?:#\s*(.*))?$", re.MULTILINE)
    comments = {name: comment.strip() for name, comment in pattern.findall(source)}
    return {
        field.name: comments.get(field.name)
        or _MEANS.get(f"{record_type.__name__}.{field.name}")
        or _MEANS.get(field.name, "")
        for field in fields(record_type)
    }


def _head() -> Iterator[str]:
    yield "# The log of a run"
    yield ""
    yield (
        "One file, `run.mcap`, holds all of a run: what it was made from, every record of what "
        "happened, and what Foxglove shows of it. It is an [MCAP](https://mcap.dev/spec) file "
        f"(version 0) of the format `{FORMAT}`; nothing else is needed to watch it, to check it "
        "(`twin validate`), to run it again (`twin validate --replay`) or to read it with other "
        "programs. This page is written by `twin schema -o docs/log-format.md`."
    )
    yield ""
    yield "## The file"
    yield ""
    yield "- Chunks of 1 MiB, compressed with zstd, each with its CRC; a summary with indexes and"
    yield "  statistics; CRCs of the data section, the summary and every attachment."
    yield "- Every message has a protobuf schema in the file (a `FileDescriptorSet`)."
    yield f"- Time: log time = publish time = {EPOCH} ({EPOCH_NS} ns since 1970) + simulated time,"
    yield "  rounded to nanoseconds. No wall clock is in the file: the same inputs give the same"
    yield "  bytes. Messages lie in the order of time."
    yield "- Schemas and channels are registered in one fixed order before the first message, also"
    yield "  those of topics on which nothing will be said."
    yield ""
    yield "| attachment | type | holds |"
    yield "|---|---|---|"
    for name, media_type in ATTACHMENTS.items():
        yield f"| `{name}` | `{media_type}` | {_ATTACHED[name]} |"
    yield ""
    yield "| metadata | holds |"
    yield "|---|---|"
    yield f"| `{RUN_METADATA}` | `format`, `world` (its name), `epoch`, and `seed.…`, the seeds |"
    yield f"| `{VERSIONS_METADATA}` | the versions of the software that wrote it |"
    yield f"| `{HASH_METADATA}` | `sha256`, the content hash |"
    yield ""
    yield "### The content hash"
    yield ""
    # The class's own words; its indented formulas stay as they are.
    yield inspect.cleandoc(ContentHash.__doc__ or "")
    yield ""


def _records() -> Iterator[str]:
    yield "## The records"
    yield ""
    yield "Slot t lasts from t·`slot_s` to (t+1)·`slot_s`; `t_s` is simulated time since the start"
    yield "of slot 0. Vertices and edges are indices into the lists of `problem.json`. `{robot}`"
    yield "and `{ap}` in a topic stand for the id in the field of that name. Lists are packed."
    yield ""
    yield f"- `link`: {', '.join(f'`{name}`' for name in LINKS)}; as a number, its place here."
    activities = (MOVING, WAITING, HELD, ARRIVED, GONE)
    yield f"- `activity`: {', '.join(f'`{name}`' for name in activities)}."
    yield f"- `cause`: {', '.join(f'`{name}`' for name in CAUSES)}."
    yield ""
    for record_type in RECORD_TYPES:
        yield from _record(record_type)


def _record(record_type: type[Record]) -> Iterator[str]:
    yield f"### `{record_type.topic}`"
    yield ""
    yield f"`{message_name(record_type)}`. {_paragraphs(record_type)}"
    yield ""
    yield "| field | number | type | unit | what |"
    yield "|---|---|---|---|---|"
    said, unit = meanings(record_type), units(record_type)
    for name, number, kind in declared(record_type):
        yield f"| `{name}` | {number} | {kind} | {unit.get(name, '')} | {_cell(said[name])} |"
    yield ""


def declared(record_type: type[Record]) -> list[tuple[str, int, str]]:
    """(name, number, type) of the fields, as the descriptor in the file declares them."""
    (message,) = file_descriptor(record_type).message_type
    repeated = descriptor_pb2.FieldDescriptorProto.LABEL_REPEATED
    return [
        (f.name, f.number, _TYPES[f.type] + ("[]" if f.label == repeated else ""))
        for f in message.field
    ]


def _pictures() -> Iterator[str]:
    yield "## What Foxglove shows"
    yield ""
    yield "Messages of Foxglove's own types, computed from the records and inputs. Each one tells"
    yield "all there is to see on its topic, since a seek delivers the last one only; everything is"
    yield f"told again every {REPEAT_S:g} s. Places are in metres in the frame `world`: x and y"
    yield "along the hall's walls, z up."
    yield ""
    yield "| topic | type | shows |"
    yield "|---|---|---|"
    for topic, message_class in TOPICS.items():
        yield f"| `{topic}` | `{message_class.DESCRIPTOR.full_name}` | {_SHOWN[topic]} |"
    yield ""


def _reading() -> Iterator[str]:
    yield "## Reading it"
    yield ""
    yield "With this project, typed and checked:"
    yield ""
    yield "```python"
    yield "import logs"
    yield "from logs.records import ApLoad, Sample"
    yield ""
    yield 'run = logs.read("run.mcap")              # every CRC checked; LogError if it is unsound'
    yield "print(run.world.name, run.plan.cost)     # the inputs, parsed when they are asked for"
    yield "loads = run.table(ApLoad)                # one numpy array per field"
    yield 'print(loads["load"].max())'
    yield "samples = run.table(Sample)              # one row per robot and instant"
    yield 'print(samples.categories["link"])        # what the numbers in `link` stand for'
    yield "for record in run.iter_records():        # or record by record, in little memory"
    yield "    pass"
    yield "```"
    yield ""
    yield "`Table.to_numpy()` gives a structured array, `Table.to_pandas()` a data frame if pandas"
    yield "is installed. Without this project, with `pip install mcap zstandard protobuf`:"
    yield ""
    yield "```python"
    yield from READER.rstrip("\n").split("\n")
    yield "```"


def _paragraphs(thing: Any) -> str:
    text = inspect.cleandoc(thing.__doc__ or "")
    return re.sub(r"(?<!\n)\n(?!\n)", " ", text)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
