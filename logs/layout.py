"""The Foxglove layout of a run: the form that "import from file" takes (`configById`).

Foxglove hides all topics of a 3D panel at first, so a log without a layout looks empty. The layout
is made from the world: the camera sees the whole hall, the colours of the coverage begin at the
threshold, every AP has its line in the load plot and every robot its row of associations.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import Any

from logs.foxglove import AP_COLORS, OUTAGE_COLOR, WORLD_FRAME, ap_color
from logs.records import ApLoad, Incident, Kpi, RobotState
from planner.prices import Prices
from planner.problem import Problem
from worlds.radio_map import RadioMap
from worlds.world import World

ROWS_PER_PANEL = 25
"""Robots per panel of associations: as many as one screen shows; more come in tabs."""
MAX_TABS = 12
"""Tabs of associations at most; robots beyond them are added by hand in Foxglove."""

COVERAGE_COLORS = ("#0b1d33d9", "#bfe3f0d9")
"""At and below the threshold, and at the highest SNR: only the lightness varies, the hues are the
APs' (`logs.foxglove.AP_COLORS`)."""

CONGESTION_COLORS = ("#fff3c400", "#b34700f2")
"""At price 0, invisible, and at the highest price."""

Json = dict[str, Any]

_FIELD_OF_VIEW_DEG = 45.0
_TILT_DEG = 35.0  # of the camera from the vertical
_FILL = 0.9  # share of the view that the hall takes up


def build_layout(
    world: World, problem: Problem, radio_map: RadioMap, prices: Prices | None = None
) -> Json:
    """The layout of a run of this world; `prices` are those of its plan, if it has any."""
    associations = _associations(problem.robot_ids)
    panels: Json = {
        "3D!hall": _hall(world, radio_map, _congestion(problem, prices)),
        "Plot!load": _load_plot(problem),
        **associations,
        "Plot!service": _plot(
            [
                (f"{Kpi.topic}.outage_s", "outage, all robots [s]", OUTAGE_COLOR),
                (f"{Kpi.topic}.worst_outage_s", "worst single outage [s]", AP_COLORS[1]),
                (f"{Kpi.topic}.handover_s", "handover interruption [s]", AP_COLORS[4]),
            ]
        ),
        "Table!kpi": {"topicPath": Kpi.topic, "foxglovePanelTitle": "Key figures"},
        "Table!events": {"topicPath": Incident.topic, "foxglovePanelTitle": "Last event"},
        "Gauge!load": {
            "foxglovePanelTitle": "Peak load / capacity",
            "path": f"{Kpi.topic}.peak_load_share",
            "minValue": 0,
            "maxValue": 1,
            "colorMode": "colormap",
            "colorMap": "red-yellow-green",
            "gradient": ["#0000ff", "#ff00ff"],
            "reverse": True,
        },
        "RosOut!log": {"topicToRender": "/log", "minLogLevel": 1, "searchTerms": []},
    }
    figures = _column("Gauge!load", 40, _column("Table!kpi", 70, "Table!events"))
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _row(
            _column("3D!hall", 72, _row("RosOut!log", 65, figures)),
            60,
            _column("Plot!load", 28, _column(next(iter(associations)), 68, "Plot!service")),
        ),
    }


def dump_layout(layout: Json) -> str:
    """A layout as JSON text; the same layout gives the same text."""
    return json.dumps(layout, ensure_ascii=False, indent=1) + "\n"


def message_path(topic: str, field: str) -> str:
    """Foxglove's path to a field of a topic, the topic quoted if it has unusual characters."""
    if not re.fullmatch(r"[A-Za-z0-9_/-]+", topic):
        topic = '"' + re.sub(r'([\\"])', r"\\\1", topic) + '"'
    return f"{topic}.{field}"


def _hall(world: World, radio_map: RadioMap, congestion: Json) -> Json:
    width, depth = world.hall.size_m
    # The near edge decides: it fills `_FILL` of the view, which is about as wide as it is high.
    tilt = math.radians(_TILT_DEG)
    reach = max(width, depth * math.cos(tilt)) / 2
    distance = reach / (_FILL * math.tan(math.radians(_FIELD_OF_VIEW_DEG / 2)))
    distance += depth / 2 * math.sin(tilt)
    visible = {"visible": True}
    return {
        "followTf": WORLD_FRAME,
        "followMode": "follow-none",
        "scene": {
            "transforms": {"visible": False, "showLabel": False, "axisScale": 0, "lineWidth": 0}
        },
        "cameraState": {
            "perspective": True,
            "distance": round(distance, 3),
            "phi": _TILT_DEG,
            "thetaOffset": 0,
            "target": [0, 0, 0],
            "targetOffset": [width / 2, depth / 2, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": _FIELD_OF_VIEW_DEG,
            "near": 0.1,
            "far": round(max(500.0, 5 * distance), 3),
        },
        "topics": {
            "/scene/static": visible,
            "/scene/robots": visible,
            "/scene/links": visible,
            "/scene/plan": visible,
            "/radio/coverage": {
                "visible": True,
                "colorField": "snr_db",
                "colorMode": "gradient",
                "gradient": list(COVERAGE_COLORS),
                "minValue": radio_map.threshold_db,
                "maxValue": _highest_snr(radio_map),
            },
            **congestion,
        },
    }


def _congestion(problem: Problem, prices: Prices | None) -> Json:
    """Settings of the prices' topic: nothing is drawn where the price is 0."""
    if prices is None:
        return {}
    highest = float(prices.in_units(prices.around(problem.edge_uv)).max(initial=0.0))
    return {
        "/radio/congestion": {
            "visible": highest > 0,
            "colorField": "price",
            "colorMode": "gradient",
            "gradient": list(CONGESTION_COLORS),
            "minValue": 0,
            "maxValue": highest or 1.0,
        }
    }


def _highest_snr(radio_map: RadioMap) -> float:
    """Upper end of the coverage's colours [dB]."""
    return float(math.ceil(radio_map.snr_db.max(initial=radio_map.threshold_db + 1)))


def _load_plot(problem: Problem) -> Json:
    lines = [
        (message_path(ApLoad.topic.format(ap=name), "load"), name, _hex(ap_color(k)))
        for k, name in enumerate(problem.ap_ids)
    ]
    capacities = sorted({int(m) for m in problem.ap_capacity})
    # A path that is a number is drawn as a level line.
    lines += [(str(m), f"capacity {m}", OUTAGE_COLOR) for m in capacities]
    plot = _plot(lines)
    return plot | {"minYValue": 0, "maxYValue": max(capacities, default=1) + 1}


def _plot(lines: Sequence[tuple[str, str, str]]) -> Json:
    return {
        "paths": [
            {
                "value": value,
                "label": label,
                "color": color,
                "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for value, label, color in lines
        ],
        "showLegend": True,
        "legendDisplay": "floating" if len(lines) <= 8 else "left",
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _associations(robots: Sequence[str]) -> Json:
    """Which AP serves each robot over time: one panel, or tabs of `ROWS_PER_PANEL` robots each."""
    groups = [robots[i : i + ROWS_PER_PANEL] for i in range(0, len(robots), ROWS_PER_PANEL)]
    groups = groups[:MAX_TABS] or [()]
    panels = {
        f"StateTransitions!ap{k}": {
            "isSynced": True,
            "paths": [
                {
                    "value": message_path(RobotState.topic.format(robot=robot), "ap"),
                    "label": robot,
                    "enabled": True,
                    "timestampMethod": "receiveTime",
                }
                for robot in group
            ],
        }
        for k, group in enumerate(groups)
    }
    if len(groups) == 1:
        return panels
    tabs = [
        {"title": f"{group[0]} – {group[-1]}", "layout": name}
        for group, name in zip(groups, panels, strict=True)
    ]
    return {"Tab!associations": {"activeTabIdx": 0, "tabs": tabs}, **panels}


def _row(left: Any, percent: float, right: Any) -> Json:
    return {"direction": "row", "splitPercentage": percent, "first": left, "second": right}


def _column(upper: Any, percent: float, lower: Any) -> Json:
    return {"direction": "column", "splitPercentage": percent, "first": upper, "second": lower}


def _hex(color: tuple[float, float, float]) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in color)
