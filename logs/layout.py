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

from logs.colors import AP_COLORS, OUTAGE_COLOR, ap_color
from logs.foxglove_parts import WORLD_FRAME
from logs.foxglove_view import AP_COVERAGE
from logs.records import ApLoad, Disturbance, Incident, Kpi, RobotState
from planner.plan import Plan
from planner.prices import Prices
from planner.problem import Problem
from worlds.radio_map import RadioMap
from worlds.world import World

ROWS_PER_PANEL = 25
"""Robots per panel of associations: as many as one screen shows; more come in tabs."""
APS_PER_PLOT = 8
"""APs per plot of loads: as many lines as one can tell apart; more come in tabs."""
MAX_TABS = 12
"""Tabs of associations at most; robots beyond them are added by hand in Foxglove."""

COVERAGE_COLORS = ("#0b1d33d9", "#bfe3f0d9")
"""At and below the threshold, and at the highest SNR: only the lightness varies, the hues are the
APs' (`logs.colors.AP_COLORS`)."""

CONGESTION_COLORS = ("#fff3c400", "#b34700f2")
"""At price 0, invisible, and at the highest price."""

Json = dict[str, Any]

_FIELD_OF_VIEW_DEG = 45.0
_TILT_DEG = 35.0  # of the camera from the vertical
_FILL = 0.9  # share of the view that the hall takes up


def build_layout(
    world: World,
    problem: Problem,
    radio_map: RadioMap,
    prices: Prices | None = None,
    busiest: Sequence[str] = (),
) -> Json:
    """The layout of a run of this world.

    Args:
        world, problem, radio_map: of the run.
        prices: of its plan, if it has any.
        busiest: robots to look at first, where there are more than one panel shows
            (`busiest_robots`).
    """
    associations = _associations(problem.robot_ids, busiest)
    loads = _load_plots(problem)
    panels: Json = {
        "3D!hall": _hall(world, radio_map, problem, _congestion(problem, prices)),
        **loads,
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
        "Table!disturbances": {
            "topicPath": Disturbance.topic,
            "foxglovePanelTitle": "Last disturbance",
        },
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
    last = _column("Table!events", 50, "Table!disturbances")
    figures = _column("Gauge!load", 35, _column("Table!kpi", 60, last))
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _row(
            _column("3D!hall", 72, _row("RosOut!log", 65, figures)),
            60,
            _column(next(iter(loads)), 28, _column(next(iter(associations)), 68, "Plot!service")),
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


def busiest_robots(plan: Plan) -> tuple[str, ...]:
    """The robots with the most planned handovers, then the longest ways: as many as a panel shows.

    A layout is made before the run, so it goes by the plan.
    """
    paths = [path for path in plan.paths if path is not None]
    paths.sort(key=lambda path: (-path.handovers, -path.arrival, path.robot))
    return tuple(path.robot for path in paths[:ROWS_PER_PANEL])


def _hall(world: World, radio_map: RadioMap, problem: Problem, congestion: Json) -> Json:
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
            "/scene/paths": visible,
            "/scene/disturbances": visible,
            "/scene/events": visible,
            # All of every path at once hides the hall; it is there to be switched on.
            "/scene/plan": {"visible": False},
            "/radio/coverage": _snr_colors(radio_map, visible=True),
            "/radio/best_server": {"visible": False, "colorMode": "rgba-fields"},
            **{
                AP_COVERAGE.format(ap=ap): _snr_colors(radio_map, visible=False)
                for ap in problem.ap_ids
            },
            **congestion,
        },
    }


def _snr_colors(radio_map: RadioMap, *, visible: bool) -> Json:
    """Settings of a coverage grid: the colours begin at the threshold."""
    return {
        "visible": visible,
        "colorField": "snr_db",
        "colorMode": "gradient",
        "gradient": list(COVERAGE_COLORS),
        "minValue": radio_map.threshold_db,
        "maxValue": _highest_snr(radio_map),
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


def _load_plots(problem: Problem) -> Json:
    """Load of each AP over time: one plot, or tabs of `APS_PER_PLOT` APs each."""
    lines = [
        (message_path(ApLoad.topic.format(ap=name), "load"), name, _hex(ap_color(k)))
        for k, name in enumerate(problem.ap_ids)
    ]
    pages = [
        range(i, min(i + APS_PER_PLOT, len(lines))) for i in range(0, len(lines), APS_PER_PLOT)
    ]
    pages = pages or [range(0)]
    names = ["Plot!load", *(f"Plot!load{k}" for k in range(1, len(pages)))]
    plots: Json = {}
    for name, page in zip(names, pages, strict=True):
        capacities = sorted({int(problem.ap_capacity[k]) for k in page})
        # A path that is a number is drawn as a level line.
        levels = [(str(m), f"capacity {m}", OUTAGE_COLOR) for m in capacities]
        plot = _plot([*(lines[k] for k in page), *levels])
        plots[name] = plot | {"minYValue": 0, "maxYValue": max(capacities, default=1) + 1}
    if len(pages) == 1:
        return plots
    tabs = [
        {"title": f"{problem.ap_ids[page[0]]} – {problem.ap_ids[page[-1]]}", "layout": name}
        for name, page in zip(names, pages, strict=True)
    ]
    return {"Tab!loads": {"activeTabIdx": 0, "tabs": tabs}, **plots}


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


def _associations(robots: Sequence[str], busiest: Sequence[str]) -> Json:
    """Which AP serves each robot over time: one panel, or tabs of `ROWS_PER_PANEL` robots each.

    Before the tabs of all robots comes one of those that change their AP most.
    """
    groups = [robots[i : i + ROWS_PER_PANEL] for i in range(0, len(robots), ROWS_PER_PANEL)]
    groups = groups[:MAX_TABS] or [()]
    titles = [f"{group[0]} – {group[-1]}" if group else "" for group in groups]
    if len(groups) > 1 and busiest:
        groups, titles = [busiest, *groups], ["most handovers", *titles]
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
    tabs = [{"title": title, "layout": name} for title, name in zip(titles, panels, strict=True)]
    return {"Tab!associations": {"activeTabIdx": 0, "tabs": tabs}, **panels}


def _row(left: Any, percent: float, right: Any) -> Json:
    return {"direction": "row", "splitPercentage": percent, "first": left, "second": right}


def _column(upper: Any, percent: float, lower: Any) -> Json:
    return {"direction": "column", "splitPercentage": percent, "first": upper, "second": lower}


def _hex(color: tuple[float, float, float]) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in color)
