"""Outcome of a run and its figures."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cosim.recording import Recording
from twin.flight.closed_loop import lost
from twin.representation import ShortRepr

from ..jobs import journal
from ..simulation import summary

Array = NDArray[np.float64]
MOTORS = 12
"""Number of rotors of the largest known aircraft."""
WATCHED = {
    *(f"airframe.pos_{a}" for a in "xyz"),
    *(f"mission.setpoint_pos_{a}" for a in "xyz"),
    *(f"airframe.q_{a}" for a in "wxyz"),
    "mission.phase",
    *(f"controller.cmd_{i}" for i in range(1, MOTORS + 1)),
}
"""Outputs from which the figures of a flight are computed."""
FIGURES = {
    "tracking_rms_m": "m",
    "tracking_worst_m": "m",
    "tilt_worst_rad": "rad",
    "saturated_share": "1",
    "end_pos_x_m": "m",
    "end_pos_y_m": "m",
    "end_pos_z_m": "m",
}
"""Units of the figures of a flight."""
POSITION, SETPOINT = "airframe.pos", "mission.setpoint_pos"
"""Outputs of the twin, without the suffix of the axis."""
RISEN = 0.5
"""Share of the commanded height from which on an aircraft counts as airborne."""
AT_LIMIT = 1e-3
"""Distance from 0 or 1 within which a motor command counts as saturated."""
How = Literal["flown", "lost", "run", "failed"]
"""flown: completed, upright and near its setpoints; lost: completed, but not so; run: completed,
with no known aircraft; failed: ended by an FMU."""


@dataclass(frozen=True, slots=True)
class Outcome(ShortRepr):
    """Outcome of one run.

    Attributes:
        run: Number of the run.
        outcome: Kind of outcome.
        why: Reason why it was lost or failed; else "".
        time_s: Simulated time reached, s.
        figures: Figures by name, units in `FIGURES`.
    """

    run: int
    outcome: How
    why: str
    time_s: float
    figures: dict[str, float]

    def json(self) -> dict[str, Any]:
        """Content of its line in the journal, without values that are not finite."""
        finite = {k: v for k, v in self.figures.items() if np.isfinite(v)}
        return {
            "run": self.run,
            "outcome": self.outcome,
            "why": self.why,
            "time_s": self.time_s,
            "figures": finite,
        }


def outcome_of(run: int, recording: Recording, arm_m: float | None, why: str = "") -> Outcome:
    """Outcome and figures of a recording.

    Args:
        run: Number of the run.
        recording: Recording up to the end of the run.
        arm_m: Arm length of the aircraft, m; None: the system may not be an aircraft.
        why: Reason why the run was not completed; "" where it was.
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
    """Message that the aircraft rose by less than half of the commanded height; else ""."""
    names = [n.removeprefix("twin.") for n in recording.names]
    down = {n: recording.values[:, names.index(f"{n}_z")] for n in (POSITION, SETPOINT)}
    rose, wanted = (float(z[0] - z.min()) for z in down.values())
    if rose >= RISEN * wanted:
        return ""
    return f"stayed down: rose {rose:.2f} m of the {wanted:.2f} m that were wanted"


def _saturated(recording: Recording) -> float:
    """Share of the rows in the air in which a motor command is saturated; NaN without commands."""
    names = [n.removeprefix("twin.") for n in recording.names]
    motors = [i for i, n in enumerate(names) if n.startswith("controller.cmd_")]
    if not motors or "mission.phase" not in names:
        return float("nan")
    flying = recording.values[:, names.index("mission.phase")] > 0
    commands = recording.values[flying][:, motors]
    at_limit = (commands < AT_LIMIT) | (commands > 1 - AT_LIMIT)
    return float(np.mean(at_limit.any(axis=1))) if len(commands) else float("nan")


JOURNAL = "sweep.jsonl"
"""Name of the journal file, which marks an unfinished sweep."""


class Journal(journal.Journal[int]):
    """Journal of the completed runs of a sweep, by number."""

    kind = "sweep"
    differs = "other scenario, design, seed, files or version"

    def named(self, content: journal.Content) -> int:
        """Number of the run."""
        return Outcome(**content).run

    def add(self, outcome: Outcome) -> None:
        """Append the outcome of a run."""
        self.write(outcome.json())

    def outcomes(self) -> Iterator[Outcome]:
        """All outcomes in the order in which they were written."""
        return (Outcome(**content) for _, content in self.contents())
