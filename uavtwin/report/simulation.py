"""Page of `uavtwin simulate`: the flight, then every output over time."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.recording import Recording
from twin.flight.mission import PHASES
from twin.formatting import pretty_unit

from ..run import Run
from .drawing import Budget, Panels, Spans, fitted, spans_of, thinned
from .overview import Track, track_plots
from .page import BLACK, BLUE, Figure, Plot, plot, render

Array = NDArray[np.float64]
_ROW_PX = 150
"""Height of a panel, px."""
_COLOURS = (BLUE, "#d9622b", "#2f8f5b", "#8a4fbf", "#b58900", "#c23b66", "#3aa0a8", "#6b7280")
SETPOINT, FLOWN = "setpoint", "flown"
"""Names of the curves."""
_FOLLOWED = (
    ("airframe.pos", "mission.setpoint_pos", "position", ("north", "east", "down")),
    ("airframe.vel", "mission.setpoint_vel", "velocity", ("north", "east", "down")),
)
"""Column stem of the flown quantity, that of its setpoint, its name, and its axes."""
PHASE = "mission.phase"
"""Output with the phase of the mission."""


def page_text(run: Run, facts: Mapping[str, Any] | None = None) -> str:
    """The page of a run.

    Args:
        run: Run to show.
        facts: Settings of the run, name and value; None: those of the run.
    """
    facts = run.facts if facts is None else facts
    return fitted(lambda budget: _page(run, _Shown(run.recording, run.units, budget), facts))


def _page(run: Run, shown: "_Shown", facts: Mapping[str, Any]) -> str:
    groups: dict[str, dict[str, list[str]]] = {}
    for column in shown.names:
        part, stem = _place(column)
        groups.setdefault(part, {}).setdefault(stem, []).append(column)
    parts = [
        {"name": part, "figure": shown.part(i, part, stems)}
        for i, (part, stems) in enumerate(groups.items())
    ]
    return render(
        "flight.html.j2",
        name=run.name,
        claim=run.claim,
        facts=dict(facts),
        track=shown.track(),
        followed=shown.followed(),
        parts=parts,
        note=shown.note,
    )


def _place(column: str) -> tuple[str, str]:
    """Part of the twin and quantity: "airframe.pos_x" -> airframe, pos."""
    part, _, variable = column.removeprefix("twin.").partition(".")
    return part, re.sub(r"_(?:[wxyz]|\d+)$", "", variable)


class _Shown:
    """A recording as figures."""

    def __init__(self, recording: Recording, units: Mapping[str, str], budget: Budget) -> None:
        self._recording, self._units, self._budget = recording, units, budget
        self.names = recording.names
        self._t = np.asarray(recording.time_s, dtype=np.float64)
        self._fused = any(n.startswith("twin.") for n in recording.names)
        self._there = {n.removeprefix("twin."): n for n in recording.names}
        self._spans = self._phases()

    @property
    def note(self) -> str:
        """Note on data omitted from the figures, "" if none."""
        columns = self._budget.columns
        if 2 * columns >= len(self._t):
            return ""
        return f"Drawn: the least and the largest value in each of {columns} spans of time."

    def _phases(self) -> Spans:
        """Phases of the mission, if it has some."""
        if PHASE not in self._there or len(self._t) < 2:
            return ()
        names = {code: name for name, code in PHASES.items()}
        known = np.array([names.get(code, "") for code in np.rint(self[PHASE]).tolist()])
        return spans_of(self._t, known)

    def __getitem__(self, column: str) -> Array:
        return np.asarray(self._recording[self._there[column]], dtype=np.float64)

    def _vector(self, stem: str, letters: str = "xyz") -> Array | None:
        """Columns of a vector, shape (n, k); None where the recording lacks one."""
        names = [f"{stem}_{a}" for a in letters]
        if not {*names} <= self._there.keys():
            return None
        return np.column_stack([self[n] for n in names])

    def track(self) -> list[Plot]:
        """The flight from above, from the side and in space; none without a flight."""
        flown = self._vector("airframe.pos")
        if flown is None or len(self._t) < 2:
            return []
        tracks = [Track(FLOWN, self._t, flown, BLACK)]
        wanted = self._vector("mission.setpoint_pos")
        if wanted is not None:
            tracks.append(Track(SETPOINT, self._t, wanted, BLUE, "dash"))
        q = self._vector("airframe.q", "wxyz")
        return track_plots("flight", tracks, self._budget, None if q is None else (self._t, q))

    def followed(self) -> list[Plot]:
        """Setpoint and flight over time."""
        plots = []
        for stem, wanted, words, axes in _FOLLOWED:
            flown, setpoint = self._vector(stem), self._vector(wanted)
            if flown is None or setpoint is None:
                continue
            unit = pretty_unit(self._units.get(self._there[f"{stem}_x"], "1"))
            panels = Panels((_ROW_PX,) * 3, "flight")
            for i, axis in enumerate(axes):
                number = panels.add(f"{words} {axis}, {unit}")
                for values, name, colour, dash in (
                    (flown, FLOWN, BLACK, "solid"),
                    (setpoint, SETPOINT, BLUE, "dash"),
                ):
                    x, y = thinned(self._t, values[:, i], self._budget.columns)
                    panels.line(number, x, y, name, {"color": colour, "width": 1.5, "dash": dash})
            label = f"{words}: setpoint and flight over time"
            plots.append(plot(f"followed-{words}", label, self._looked(panels)))
        return plots

    def part(self, index: int, part: str, stems: Mapping[str, Sequence[str]]) -> Plot:
        """All outputs of a part, a panel per quantity."""
        panels = Panels((_ROW_PX,) * len(stems), "flight")
        for stem, columns in stems.items():
            unit = self._units.get(columns[0], "")
            axes = panels.add(stem if unit in ("", "1") else f"{stem}, {pretty_unit(unit)}")
            for i, column in enumerate(columns):
                label = column.removeprefix("twin." if self._fused else "").partition(".")[2]
                x, y = thinned(self._t, np.asarray(self._recording[column]), self._budget.columns)
                if len(y) and np.ptp(y) == 0:
                    x, y = x[[0, -1]], y[[0, -1]]  # a constant
                line = {"color": _COLOURS[i % len(_COLOURS)], "width": 1.3}
                panels.line(axes, x, y, label or column, line)
        return plot(f"part-{index}", f"Outputs of {part} over time", self._looked(panels))

    def _looked(self, panels: Panels) -> Figure:
        """The figure over all time, with the phases of the mission."""
        if len(self._t) > 1:
            panels.look(float(self._t[0]), float(self._t[-1]), self._spans)
        return panels.figure
