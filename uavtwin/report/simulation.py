"""The page that `uavtwin simulate` leaves: every output over time, part by part."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from cosim.recording import Recording

from .figures import embedded
from .page import render

MAX_POINTS = 4000
"""Rows of one trace above which the plot, never the recording, is thinned."""
_ROW_PX, _EDGE_PX = 170, 60
_COLOURS = ("#1f5fd0", "#d9622b", "#2f8f5b", "#8a4fbf", "#b58900", "#c23b66", "#3aa0a8", "#6b7280")
_OVERLAYS = {"airframe.pos": "mission.setpoint_pos", "airframe.vel": "mission.setpoint_vel"}
"""What is drawn dashed behind a quantity."""


def write_simulation_report(
    recording: Recording,
    units: Mapping[str, str],
    claim: str,
    facts: Mapping[str, Any],
    name: str,
    path: Path,
) -> None:
    """Write the page.

    Args:
        recording: What to show.
        units: Unit of each column, where known.
        claim: The sentence on top.
        facts: Name and value, below it.
        name: Of the scenario.
        path: HTML file to write; an existing one is replaced.
    """
    every = -(-len(recording.time_s) // MAX_POINTS)
    note = f"every {every} rows of the recording are drawn as one" if every > 1 else ""
    groups: dict[str, dict[str, list[str]]] = {}
    for column in recording.names:
        part, stem = _place(column)
        groups.setdefault(part, {}).setdefault(stem, []).append(column)
    parts = []
    for part, stems in groups.items():
        figure = _figure(recording, part, stems, units, every)
        height = _EDGE_PX + _ROW_PX * len(stems)
        parts.append({"name": part, "json": embedded(figure), "height": height, "note": note})
    page = render("flight.html.j2", {}, name=name, claim=claim, facts=dict(facts), parts=parts)
    path.write_text(page, encoding="utf-8")


def _place(column: str) -> tuple[str, str]:
    """Part of the twin and quantity: "airframe.pos_x" -> airframe, pos."""
    part, _, variable = column.removeprefix("twin.").partition(".")
    return part, re.sub(r"_(?:[wxyz]|\d+)$", "", variable)


def _figure(
    recording: Recording,
    part: str,
    stems: Mapping[str, Sequence[str]],
    units: Mapping[str, str],
    every: int,
) -> go.Figure:
    figure = make_subplots(
        rows=len(stems), cols=1, shared_xaxes=True, vertical_spacing=min(0.02, 0.2 / len(stems))
    )
    t = recording.time_s[::every]
    prefix = "twin." if any(n.startswith("twin.") for n in recording.names) else ""
    for row, (stem, columns) in enumerate(stems.items(), start=1):
        wanted = _OVERLAYS.get(f"{part}.{stem}")
        for i, column in enumerate(columns):
            colour = _COLOURS[i % len(_COLOURS)]
            label = column.removeprefix(prefix).partition(".")[2]
            figure.add_scatter(
                x=t,
                y=_thin(recording[column], every),
                name=label,
                mode="lines",
                line={"color": colour, "width": 1.3},
                row=row,
                col=1,
            )
            setpoint = None if wanted is None else f"{prefix}{wanted}{column[-2:]}"
            if setpoint in recording.names:
                figure.add_scatter(
                    x=t,
                    y=_thin(recording[setpoint], every),
                    name=f"{label} setpoint",
                    mode="lines",
                    line={"color": colour, "width": 1, "dash": "dot"},
                    row=row,
                    col=1,
                )
        unit = units.get(columns[0], "")
        title = stem if unit in ("", "1") else f"{stem}, {unit}"
        figure.update_yaxes(title_text=title, title_font_size=12, row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=len(stems), col=1)
    figure.update_layout(
        template="plotly_white",
        margin={"l": 70, "r": 20, "t": 20, "b": 40},
        legend={"font": {"size": 11}},
        font={"size": 12},
    )
    return figure


def _thin(values: Any, every: int) -> list[float]:
    return [float(f"{v:.6g}") for v in np.asarray(values)[::every]]
