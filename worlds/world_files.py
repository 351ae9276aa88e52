"""Files that a world names: taken into what the world says, so that it is complete on its own.

Done before anything is checked, on the plain values of the TOML file. A world whose text comes from
elsewhere (out of a log) may not name files: nothing is read outside what a file on the disk names.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from worlds.errors import Fault, Key, WorldError
from worlds.part import given, listed

Data = dict[str, Any]


def take_in_files(data: Data, folder: Path | None) -> list[Fault]:
    """Replace the files that `data` names by what they hold, in place.

    Args:
        data: what a world file says.
        folder: to which paths are relative; None where there is no file, so none may be named.

    Returns:
        What is wrong with the files.
    """
    faults: list[Fault] = []
    graph = given(given(data, "hall"), "graph")
    if isinstance(graph, dict) and isinstance(graph.get("lif"), str):
        key: Key = ("hall", "graph", "lif")
        faults += _taken_in(key, graph["lif"], folder, lambda path: _take_lif(data, graph, path))
    radio = given(data, "radio")
    measured = given(radio, "measured")
    if isinstance(radio, dict) and isinstance(measured, str):
        radio["measured"] = measured = {"file": measured}
    if isinstance(measured, dict) and isinstance(measured.get("file"), str):
        key = ("radio", "measured")
        name = measured["file"]
        faults += _taken_in(key, name, folder, lambda path: _take_survey(data, measured, path))
    return faults


def _taken_in(
    key: Key, name: str, folder: Path | None, take: Callable[[Path], None]
) -> list[Fault]:
    if folder is None:
        rule = f"'{name}' is a file, which only a world read from a file can name"
        return [Fault(key, f"{rule}; give the contents instead")]
    try:
        take(folder / name)
    except WorldError as error:
        return [Fault(key, line) for line in error.lines]
    except ValueError as error:  # a path that cannot be one
        return [Fault(key, f"'{name}' cannot be read: {error}")]
    return []


def _take_lif(data: Data, graph: Data, path: Path) -> None:
    """Nodes, edges and stations of a LIF file; stations of the world itself come first."""
    from worlds.formats.lif import read_lif

    if "node" in graph or "edge" in graph:
        return  # told of as a key beside `lif`
    choice = {key: graph.get(key) for key in ("layout", "vehicle")}
    lif = read_lif(path, **{k: v if isinstance(v, str) else None for k, v in choice.items()})
    del graph["lif"]
    graph["layout"], graph["vehicle"] = lif.layout, lif.vehicle
    graph["node"] = [node.model_dump(exclude_none=True) for node in lif.nodes]
    graph["edge"] = [edge.model_dump(exclude_none=True) for edge in lif.edges]
    if lif.remarks:
        graph["remarks"] = list(lif.remarks)
    stations = data.setdefault("station", [])
    if isinstance(stations, list):
        stations += [{"name": s.id, "nodes": list(s.nodes)} for s in lif.stations]


def _take_survey(data: Data, measured: Data, path: Path) -> None:
    """The text of a table of measurements, checked against the APs there are."""
    from worlds.formats.json_file import read_text
    from worlds.formats.survey_csv import WHAT, parse_survey

    if "csv" in measured:
        return  # told of as a key beside `file`
    text = read_text(path, WHAT)
    names = [given(ap, "id") for ap in listed(data, "ap")]
    size = [s for s in listed(given(data, "hall"), "size_m") if isinstance(s, int | float)]
    parse_survey(
        text,
        str(path),
        [name for name in names if isinstance(name, str)],
        0.0,
        (float(size[0]), float(size[1])) if len(size) == 2 else None,
    )
    del measured["file"]
    measured["csv"] = "\n".join(text.splitlines()) + "\n"
    measured["source"] = path.name
