"""HTML document of the live page, which needs only its WebSocket."""

import gzip
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from twin.frames import AXES
from twin.logs.columns import ACC, GYRO, POS, VEL, motor_columns

from ...report.drawing import Panels
from ...report.page import BLACK, BLUE, GREY, ORANGE, Figure, Plot, plot, render
from ...report.page import HERE as REPORT
from ...site.server import hash_of, headers, style
from .feed import ANGLES

HERE = Path(__file__).parent  # scripts and styles
_PANEL_PX, _LOW_PX = 118, 96
"""Heights of panels, px."""
_MOTOR_COLOURS = ("#1f5fd0", "#e07b1a", "#2f8f5b", "#8a4fbf", "#b58900", "#c23b66", "#3aa0a8")
_NONE = np.zeros(0)
"""Data of a curve that the stream fills."""
MEASURED_LINE = {"color": BLACK, "width": 1.3}
"""Line of the measured flight."""
TWIN_LINE = {"color": BLUE, "width": 1.3}
"""Line of the twin."""
BOTH = (("", "measured", MEASURED_LINE), ("twin.", "twin", TWIN_LINE))
"""The two aircraft: prefix of their columns, name, line style."""
TABLE: Sequence[tuple[str, str, Sequence[str], int]] = (
    ("acceleration", "m/s²", ACC, 2),
    ("body rates", "rad/s", GYRO, 3),
    ("attitude", "°", ANGLES, 1),
    ("velocity", "m/s", VEL, 2),
    ("position", "m", POS, 2),
)
"""Numbers at the top: name, unit, columns, digits."""


@dataclass(frozen=True, slots=True)
class Document:
    """A page and its HTTP headers.

    Attributes:
        html: HTML text of the page.
        headers: Headers of the answer: allowed scripts.
    """

    html: str
    headers: dict[str, str]


@cache
def document(motors: int, bar: str = "") -> Document:
    """The page for an aircraft.

    Args:
        motors: Number of motors.
        bar: Navigation bar of the site.
    """
    html = render(
        "live.html.j2",
        folder=HERE,
        bar=bar,
        style_live=Markup(style() + (HERE / "live.css").read_text("utf-8")),
        script_live=Markup((HERE / "live.js").read_text("utf-8")),
        table=TABLE,
        measured=_measured_plots(),
        teacher_forced=_residuals("imu", (*ACC, *(f"gyro_rate_{a}" for a in AXES)), False),
        short_horizon=_residuals("ends", (*VEL, *(f"att_{a}" for a in AXES)), True),
        tracks=_tracks(),
        power=_power(motors),
    )
    return Document(html, _headers(html))


def _headers(html: str) -> dict[str, str]:
    scripts = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    bundle = gzip.decompress((REPORT / "vendor" / "plotly-basic.min.js.gz").read_bytes())
    return headers(list(map(hash_of, (*scripts, bundle.decode()))))


def _follow(panels: Panels, x: str, y: str) -> None:
    """Connect the newest curve to columns of the stream; live.js fills it."""
    panels.figure["data"][-1]["meta"] = {"x": x, "y": y}


def _measured_plots() -> list[Plot]:
    titles = ("m/s²", "rad/s", "deg", "m/s")
    names = ("Acceleration", "Body rates", "Attitude", "Velocity")
    columns = (ACC, GYRO, ANGLES, VEL)
    found = []
    for name, unit, three in zip(names, titles, columns, strict=True):
        panels = Panels([_LOW_PX] * 3, "live")
        for k, column in enumerate(three):
            axes = panels.add(f"{column}, {unit}")
            for prefix, who, line in BOTH:
                more = {"legendgroup": who, "showlegend": k == 0}
                panels.line(axes, _NONE, _NONE, who, line, **more)
                _follow(panels, "now.t", f"now.{prefix}{column}")
        label = f"{name}: measured and twin over time"
        found.append(plot(f"measured-{three[0]}", label, panels.figure))
    return found


def _residuals(name: str, columns: Sequence[str], short: bool) -> Plot:
    """Residuals over time, with the expected band in the background."""
    units = {"acc": "m/s²", "gyro_rate": "rad/s²", "vel": "m/s", "att": "rad"}
    panels = Panels([_LOW_PX] * len(columns), "live")
    for k, column in enumerate(columns):
        axes = panels.add(f"{column}, {units[column[:-2]]}", y={"zeroline": True})
        key = f"{'short' if short else 'forced'}.{column}"
        panels.area(axes, 0.0, 0.0)
        panels.layout["shapes"][-1] |= {"name": key, "visible": False}
        mark: dict[str, Any] = {"mode": "lines+markers", "marker": {"size": 4}} if short else {}
        more = {"legendgroup": "residual", "showlegend": k == 0, **mark}
        panels.line(axes, _NONE, _NONE, "residual", {"color": ORANGE, "width": 1.2}, **more)
        _follow(panels, f"{key}.t", f"{key}.residual")
    kind = "at the ends of short windows" if short else "teacher-forced"
    return plot(
        f"residuals-{name}", f"Residuals {kind}, and where they are expected", panels.figure
    )


def _tracks() -> list[Plot]:
    """Tracks of both aircraft from above, from the south, and in space."""
    found = []
    for name, label, up in (("above", "from above", "pos_x"), ("side", "from the south", "up")):
        panels = Panels((264,))
        words = "north, m" if up == "pos_x" else "up, m"
        scale = {"scaleanchor": "x", "scaleratio": 1}
        axes = panels.add(words, {"title": {"text": "east, m"}, "nticks": 6}, scale)
        for prefix, who, line in BOTH:
            panels.line(axes, _NONE, _NONE, who, line)
            _follow(panels, f"track.{prefix}pos_y", f"track.{prefix}{up}")
        found.append(plot(f"track-{name}", f"Track {label}: measured and twin", panels.figure))
    colours = {"measured": BLACK, "twin": BLUE}
    lines = [{"name": n, "colour": c, "dash": "", "points": []} for n, c in colours.items()]
    scene: Figure = {
        "height": 330,
        "low": [-0.5, -0.5, 0.0],
        "high": [0.5, 0.5, 1.0],
        "span": ["", "", ""],
        "lines": lines,
        "bodies": [],
    }
    label = "Track in space, and the attitude of both; arrow keys turn it"
    return [*found, plot("track-space", label, scene, scene=True)]


def _power(motors: int) -> Plot:
    panels = Panels((_LOW_PX, _LOW_PX, _PANEL_PX, _PANEL_PX), "live")
    for column, unit in (("vbat_v", "V"), ("ibat_a", "A")):
        axes = panels.add(f"battery, {unit}")
        panels.line(axes, _NONE, _NONE, "battery", {"color": GREY, "width": 1.5}, showlegend=False)
        _follow(panels, "now.t", f"now.{column}")
    for stem, title in (("cmd", "command, 1"), ("rotor", "rotor, rad/s")):
        axes = panels.add(title)
        for k, column in enumerate(motor_columns(stem, motors)):
            line = {"color": _MOTOR_COLOURS[k % len(_MOTOR_COLOURS)], "width": 1.2}
            who = f"motor {k + 1}"
            more = {"legendgroup": who, "showlegend": stem == "cmd"}
            panels.line(axes, _NONE, _NONE, who, line, **more)
            _follow(panels, "now.t", f"now.{column}")
    return plot("power", "Battery and motors over time", panels.figure)
