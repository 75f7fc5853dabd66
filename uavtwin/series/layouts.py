"""Layouts of PlotJuggler and Foxglove for a flight in MCAP, with the most common plots.

PlotJuggler: *Layout, Load*, with the file already open; its series are named /TOPIC/FIELD.
Foxglove: *Layouts, Import from file*; its series are named /TOPIC.FIELD.

Source: PlotJuggler 3, `PlotDocker::xmlLoadState` and `PlotWidget::xmlLoadState`; settings of panels
of Foxglove as of the module `layouts` of foxglove-sdk 0.30, in the tree by `configById` that the
program exports.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from lxml import etree

from twin.logs import Flight
from twin.logs.airframe import origin_of
from twin.logs.columns import ACC, GYRO, POS, QUAT, VEL, in_order

from ..output import output_file
from .mcap import LOCATION, plot_topics

ENDINGS = (".foxglove.json", ".plotjuggler.xml")
"""Extensions of the layouts next to an MCAP file."""
_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#ff7f0e", "#9467bd", "#8c564b", "#17becf", "#7f7f7f")
"""Colours of the curves of a plot, in order."""
_PLOTS: Mapping[str, tuple[str, ...]] = {
    "specific force, m/s^2": ACC,
    "body rates, rad/s": GYRO,
    "velocity NED, m/s": VEL,
    "position NED, m": POS,
    "commands": ("cmd_",),
    "rotor speeds, rad/s": ("rotor_",),
    "battery, V": ("vbat_v",),
}
"""Columns by title of a plot; a stem stands for one column per motor."""
_DISTANCE_M = 12.0
"""Distance of the camera from the aircraft, m."""

Curves = Sequence[tuple[str, str]]
"""Topic and field of each curve."""


def layout_files(mcap: Path) -> list[Path]:
    """The layouts next to an MCAP file."""
    return [mcap.with_suffix(ending) for ending in ENDINGS]


def write_layouts(flight: Flight, mcap: Path) -> list[Path]:
    """Write both layouts next to the MCAP file of a flight; returns their paths."""
    plots = plots_of(flight)
    in_space = flight.has(*POS, *QUAT)
    on_map = flight.has(*POS) and origin_of(flight.airframe) is not None
    texts = (foxglove(plots, in_space, on_map), plotjuggler(plots))
    files = layout_files(mcap)
    for path, text in zip(files, texts, strict=True):
        with output_file(path) as file:
            file.write_text(text, "utf-8")
    return files


def plots_of(flight: Flight) -> dict[str, Curves]:
    """Curves by title, for the columns of a flight."""
    topics = plot_topics([c for c in flight.columns if flight.has(c)])
    where = {column: topic for topic, fields in topics.items() for column in fields}
    found: dict[str, Curves] = {}
    for title, names in _PLOTS.items():
        curves = [
            (where[c], c)
            for c in in_order(where)
            if c in names or (c.rpartition("_")[0] + "_" in names and c[-1].isdigit())
        ]
        if curves:
            found[title] = curves
    return found


def plotjuggler(plots: Mapping[str, Curves]) -> str:
    """A layout of PlotJuggler: plots below each other."""
    root = etree.Element("root")
    window = etree.SubElement(root, "tabbed_widget", name="Main Window", parent="main_window")
    tab = etree.SubElement(window, "Tab", containers="1", tab_name="flight")
    container = etree.SubElement(tab, "Container")
    share = f"{1 / max(1, len(plots)):.6f}"
    sizes = {"orientation": "-", "count": str(len(plots)), "sizes": ";".join([share] * len(plots))}
    splitter = etree.SubElement(container, "DockSplitter", sizes)
    for title, curves in plots.items():
        area = etree.SubElement(splitter, "DockArea", name=title)
        kind = {"style": "Lines", "mode": "TimeSeries", "flip_x": "false", "flip_y": "false"}
        plot = etree.SubElement(area, "plot", kind)
        etree.SubElement(plot, "limitY")
        for k, (topic, field) in enumerate(curves):
            colour = _COLOURS[k % len(_COLOURS)]
            etree.SubElement(plot, "curve", name=f"{topic}/{field}", color=colour)
    etree.SubElement(window, "currentTabIndex", index="0")
    etree.SubElement(root, "use_relative_time_offset", enabled="1")
    text: str = etree.tostring(root, encoding="unicode", pretty_print=True)
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{text}"


def foxglove(plots: Mapping[str, Curves], in_space: bool, on_map: bool) -> str:
    """A layout of Foxglove: the aircraft in space, on the map where it has one, and plots.

    Args:
        plots: Curves by title.
        in_space: Whether the file has a pose.
        on_map: Whether the file has a location.
    """
    panels = dict(_panels(plots, in_space, on_map))
    seen = [name for name in panels if not name.startswith("Plot!")]
    drawn = [name for name in panels if name.startswith("Plot!")]
    halves = [_stacked(names) for names in (seen, drawn) if names]
    layout = halves[0] if halves else ""
    for half in halves[1:]:
        layout = _split("row", layout, half, 40.0)
    content = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(content, indent=1) + "\n"


def _panels(
    plots: Mapping[str, Curves], in_space: bool, on_map: bool
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Settings of each panel, by its identifier."""
    if in_space:
        camera = {
            **{"perspective": True, "distance": _DISTANCE_M, "phi": 60, "thetaOffset": 45},
            **{"target": [0, 0, 0], "targetOffset": [0, 0, 0], "targetOrientation": [0, 0, 0, 1]},
            **{"fovy": 45, "near": 0.5, "far": 5000},
        }
        yield (
            "3D!uavtwin",
            {
                "followTf": "map",
                "cameraState": camera,
                "layers": {
                    "grid": {"layerId": "foxglove.Grid", "instanceId": "grid", "visible": True}
                },
                "topics": {"/pose": {"visible": True, "type": "axis"}},
            },
        )
    if on_map:
        yield "map!uavtwin", {"followTopic": LOCATION}
    for k, (title, curves) in enumerate(plots.items()):
        paths = [
            {"value": f"{topic}.{field}", "enabled": True, "timestampMethod": "receiveTime"}
            for topic, field in curves
        ]
        yield (
            f"Plot!uavtwin{k}",
            {
                **{"foxglovePanelTitle": title, "paths": paths, "isSynced": True},
                **{"showLegend": True, "legendDisplay": "floating", "xAxisVal": "timestamp"},
                **{"showXAxisLabels": True, "showYAxisLabels": True},
            },
        )


def _stacked(names: Iterable[str]) -> Any:
    """Panels of equal height below each other."""
    first, *others = names
    if not others:
        return first
    return _split("column", first, _stacked(others), 100 / (1 + len(others)))


def _split(direction: str, first: Any, second: Any, percent: float) -> dict[str, Any]:
    return {
        **{"direction": direction, "first": first, "second": second},
        "splitPercentage": round(percent, 3),
    }
