"""What came of a run, in figures."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cosim.recording import Recording
from twin.flight.closed_loop import lost
from twin.representation import short_repr

from ..jobs import journal
from ..simulation import summary

Array = NDArray[np.float64]
MOTORS = 12
"""Of the largest aircraft that is known."""
WATCHED = {
    *(f"airframe.pos_{a}" for a in "xyz"),
    *(f"mission.setpoint_pos_{a}" for a in "xyz"),
    *(f"airframe.q_{a}" for a in "wxyz"),
    "mission.phase",
    *(f"controller.cmd_{i}" for i in range(1, MOTORS + 1)),
}
"""Outputs that the figures of a flight are made of."""
FIGURES = {
    "tracking_rms_m": "m",
    "tracking_worst_m": "m",
    "tilt_worst_rad": "rad",
    "saturated_share": "1",
    "end_pos_x_m": "m",
    "end_pos_y_m": "m",
    "end_pos_z_m": "m",
}
"""Of a flight, and their units."""
POSITION, SETPOINT = "airframe.pos", "mission.setpoint_pos"
"""Outputs of the twin, without their axes."""
RISEN = 0.5
"""Share of the height that was wanted, from which on an aircraft has taken off."""
AT_LIMIT = 1e-3
"""A command as close as that to 0 or 1 is at its limit."""
How = Literal["flown", "lost", "run", "failed"]
"""flown: to its end, upright and near its setpoints; run: to its end, and nothing is known to fly;
failed: an FMU ended it."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Of one run.

    Attributes:
        run: Its number.
        outcome: How it ended.
        why: It was lost or failed; else "".
        time_s: That it reached.
        figures: By name.
    """

    run: int
    outcome: How
    why: str
    time_s: float
    figures: dict[str, float]

    __repr__ = short_repr

    def json(self) -> dict[str, Any]:
        """On one line of the journal; what is no finite number is left out."""
        finite = {k: v for k, v in self.figures.items() if np.isfinite(v)}
        return {
            "run": self.run,
            "outcome": self.outcome,
            "why": self.why,
            "time_s": self.time_s,
            "figures": finite,
        }


def outcome_of(run: int, recording: Recording, arm_m: float | None, why: str = "") -> Outcome:
    """Figures of a recording.

    Args:
        run: Its number.
        recording: Of it, as far as it came.
        arm_m: Of the aircraft; None: nothing is known to fly.
        why: It did not come to its end; "" where it did.
    """
    time_s = float(recording.time_s[-1]) if len(recording.time_s) else 0.0
    if not len(recording.time_s):
        return Outcome(run, "failed", why, time_s, {})
    flown = summary(recording)
    if not flown:
        end_of = zip(recording.names, recording.values[-1].tolist(), strict=True)
        last = {f"end.{name}": float(value) for name, value in end_of}
        return Outcome(run, "failed" if why else "run", why, time_s, last)
    end = flown.pop("end_pos_m")
    figures = {
        **flown,
        "saturated_share": _saturated(recording),
        **{f"end_pos_{a}_m": float(v) for a, v in zip("xyz", end, strict=True)},
    }
    if why:
        return Outcome(run, "failed", why, time_s, figures)
    problem = _stayed_down(recording)
    if arm_m is not None:
        problem = problem or lost(figures["tracking_worst_m"], figures["tilt_worst_rad"], arm_m)
    return Outcome(run, "lost" if problem else "flown", problem, time_s, figures)


def _stayed_down(recording: Recording) -> str:
    """That it did not rise by half of what was wanted; "" where it did."""
    names = [n.removeprefix("twin.") for n in recording.names]
    down = {n: recording.values[:, names.index(f"{n}_z")] for n in (POSITION, SETPOINT)}
    rose, wanted = (float(z[0] - z.min()) for z in down.values())
    if rose >= RISEN * wanted:
        return ""
    return f"stayed down: rose {rose:.2f} m of the {wanted:.2f} m that were wanted"


def _saturated(recording: Recording) -> float:
    """Share of the rows in the air in which a motor command is at a limit; NaN without commands."""
    names = [n.removeprefix("twin.") for n in recording.names]
    motors = [i for i, n in enumerate(names) if n.startswith("controller.cmd_")]
    if not motors or "mission.phase" not in names:
        return float("nan")
    flying = recording.values[:, names.index("mission.phase")] > 0
    commands = recording.values[flying][:, motors]
    at_limit = (commands < AT_LIMIT) | (commands > 1 - AT_LIMIT)
    return float(np.mean(at_limit.any(axis=1))) if len(commands) else float("nan")


JOURNAL = "sweep.jsonl"
"""File that marks an unfinished sweep."""


class Journal(journal.Journal[int]):
    """Of the runs of a sweep, by their numbers."""

    kind = "sweep"
    differs = "other scenario, design, seed, files or version"

    def named(self, content: journal.Content) -> int:
        """Number of the run."""
        return Outcome(**content).run

    def add(self, outcome: Outcome) -> None:
        """Write a run down."""
        self.write(outcome.json())

    def outcomes(self) -> Iterator[Outcome]:
        """All that is written, in the order in which it was."""
        return (Outcome(**content) for _, content in self.contents())
