"""Evaluation of a learned force on new flights, through exported FMUs of several twins."""

import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from learning.force.model import VEHICLE_FILE, ForceModel
from twin.formatting import counted, number, percent
from twin.frames import AXES
from twin.logs import Flight
from twin.residuals.teacher_forced import choose_drive

from ..display import PageMixin, TextTable
from ..exports.parts import learned_force, twin
from ..exports.write import export
from ..flights import check_names, check_untaught
from ..record import Record
from ..report.learning_figures import horizons_figure
from ..report.page import plot, render
from ..series.files import CORRECTED, TWIN, Column, Series, residual_of
from ..series.files import EXPLAINED as EXPLAINED_SIDE
from ..vehicles import Vehicle, load_vehicle
from .hover_noise import HoverLevel, hover_levels, noise_claim
from .open_loop import DISTANCE, HORIZONS_S, QUANTITIES, OpenLoop, Replay

PHYSICS, EXPLAINED, SHIPPED = "physics", "explained", "corrected"
UNTRAINED = "explained + untrained observer"
"""Name of the twin with an observer but no learned law."""
SHOWN = {
    PHYSICS: "file before it was explained",
    EXPLAINED: "vehicle file",
    UNTRAINED: "vehicle file + untrained observer",
    SHIPPED: "vehicle file + observer + law",
}
"""Labels of these twins in tables."""
LAST_MOTION, LAST_READING = "last motion", "last reading"
"""Names of the two predictions without a twin, in tables and JSON: constant velocity, and
persistence."""
CLAIMED_S = 0.5
"""Horizon of the summary sentence and of the printed table, s."""
Progress = Callable[[float], None]


class ForceRecord(Record, frozen=True, kw_only=True):
    """Evaluation of a learned force on other flights.

    Attributes:
        protocol: `force`.
        vehicle: Vehicle for which it was learned.
        flights: Names of the flights.
        claim: Summary sentence of the report.
        horizons_s: Open-loop prediction horizons, s.
        inside: Share of the runs in which the corrected twin was inside the envelope at each of
            `horizons_s`, by flight.
        windows: Number of open-loop runs, by flight.
        noise: Hover spectra by third-octave, of each flight and of `corrected` in hover, with its
            noise and without; empty where it has no noise.
        summary: Rms of `position` (m), `velocity` (m/s), `attitude` (rad) and `rates` (rad/s) over
            three axes and all flights for each `model` and `horizon_s`, and
            `over_explained_median`, `over_explained_largest`, ratios over its cells to the
            explained twin.
        cells: Values of `rms` and `unit` for each `model`, `flight`, `horizon_s`, `quantity` and
            `axis`.
    """

    protocol: str
    vehicle: str
    flights: tuple[str, ...]
    claim: str
    horizons_s: tuple[float, ...]
    inside: dict[str, tuple[float, ...]]
    windows: dict[str, int]
    noise: tuple[HoverLevel, ...]
    summary: tuple[dict[str, Any], ...]
    cells: tuple[dict[str, Any], ...]


@dataclass(frozen=True, repr=False)
class ForceEvaluation(PageMixin):
    """Open-loop errors of exported twins on flights.

    Attributes:
        model: Learned force.
        table: Table with one row per twin (`model`), `flight`, `horizon_s`, `quantity` and `axis`;
            columns `unit` and `rms`, the rms error after that time of open-loop prediction.
        inside: Share of the runs in which the corrected twin was inside the training envelope at
            each of `HORIZONS_S`, by flight.
        windows: Number of open-loop runs, by flight.
        noise: Hover spectra by third-octave.
        flown: Errors in each open-loop run, by flight and twin.
    """

    model: ForceModel
    table: pd.DataFrame
    inside: Mapping[str, tuple[float, ...]]
    windows: Mapping[str, int]
    noise: tuple[HoverLevel, ...] = ()
    flown: Mapping[str, Mapping[str, OpenLoop]] = field(default_factory=dict)
    page: ClassVar[str] = __name__

    @property
    def claim(self) -> str:
        """Error reductions by physics, observer and law, and where constant velocity predicts
        better."""
        ratios = over(self.table, SHIPPED, UNTRAINED)
        flight, quantity, axis = ratios.idxmax()
        observer = float(over(self.table, UNTRAINED).median())
        share = float(np.mean([i[HORIZONS_S.index(CLAIMED_S)] for i in self.inside.values()]))
        law = ", which has no law," if not self.model.says else ""
        rows = summary(self.table)
        at = rows[rows["horizon_s"] == CLAIMED_S].set_index("model")
        lost = [q for q, _ in QUANTITIES if at.loc[LAST_MOTION, q] < at.loc[SHIPPED, q]]
        last = f"; the last motion is closer in {', '.join(lost)}" if lost else ""
        return (
            f"{CLAIMED_S:g} s after it was left alone, the untrained observer leaves "
            f"{observer:.2f} of what the vehicle file alone is off, and the corrected twin{law} "
            f"{float(ratios.median()):.2f} of what the observer leaves (medians of {len(ratios)} "
            f"cells; at most "
            f"{float(ratios.max()):.2f}, {quantity} {axis} of {flight}){last}; "
            f"{percent(share)} of these times inside the envelope."
        )

    def frame(self) -> pd.DataFrame:
        """Table with one row per twin, flight, horizon, quantity and axis."""
        return self.table.copy()

    def series(self) -> tuple[Series, ...]:
        """Time series of each flight: measured minus predicted, for each twin at the horizon of the
        summary."""
        return tuple(self._series(name, flown) for name, flown in self.flown.items())

    @cached_property
    def record(self) -> ForceRecord:
        """All numbers that are printed, as a record."""
        return ForceRecord(
            protocol="force",
            vehicle=self.model.vehicle,
            flights=tuple(self.inside),
            claim=self.claim,
            horizons_s=HORIZONS_S,
            inside=dict(self.inside),
            windows=dict(self.windows),
            noise=self.noise,
            summary=tuple(summary(self.table).to_dict("records")),
            cells=tuple(self.table.to_dict("records")),
        )

    def findings(self) -> Iterable[str | TextTable]:
        """Summary sentence and table of errors by twin."""
        yield self.claim
        if self.noise:
            yield noise_claim(self.noise)
        yield shown_table(self.table)

    def _series(self, flight: str, flown: Mapping[str, OpenLoop]) -> Series:
        """Time series of one flight."""
        at, columns = HORIZONS_S.index(CLAIMED_S), []
        about = f"{CLAIMED_S:g} s after the twin was left alone"
        sides = {PHYSICS: TWIN, EXPLAINED: EXPLAINED_SIDE, SHIPPED: CORRECTED}
        for name, side in sides.items():
            if name not in flown:
                continue
            t_s, off = flown[name].t_s + CLAIMED_S, flown[name].off[:, at]  # errors (w, 4, 3)
            for q, (quantity, unit) in enumerate(QUANTITIES):
                for k, a in enumerate(AXES):
                    column = f"{residual_of(side)}.{quantity}_{a}"
                    columns.append(Column(column, unit, t_s, -off[:, q, k], about))
        facts = {"verb": "evaluate", "vehicle": self.model.vehicle, "task": "force"}
        return Series(flight, tuple(columns), facts)

    def brief(self) -> str:
        """Protocol and flights, as one line."""
        return f"{type(self).__name__}: {counted(list(self.inside), 'flight')}"


def evaluate_force(
    folder: Path, flights: Sequence[Flight], physics: Vehicle | None, progress: Progress
) -> ForceEvaluation:
    """Replay flights through exported twins.

    Args:
        folder: Folder that `train --protocol force` wrote.
        flights: Flights, none of which is a training flight.
        physics: Vehicle before it was explained, for comparison; None: without.
        progress: Called with the share done, 0..1.

    Raises:
        TwinError: The folder holds no learned force, or a flight was used in its training or cannot
            be replayed.
    """
    force, vehicle = learned_force(folder), load_vehicle(folder / VEHICLE_FILE)
    model = force.model
    check_names(flights)
    check_untaught(flights, folder, {f.sha256: f.name for f in model.flights})
    rows, inside, windows, by_flight = [], {}, {}, {}
    twins = {
        PHYSICS: (physics, None),
        EXPLAINED: (vehicle, None),
        UNTRAINED: (vehicle, None),
        SHIPPED: (vehicle, force),
    }
    compared = {name: (own, law) for name, (own, law) in twins.items() if own is not None}
    with tempfile.TemporaryDirectory() as place:
        total, done = len(flights) * len(compared) + 1, 0  # the last one is the hover
        for flight in flights:
            replay = Replay(flight, vehicle)
            flown = {LAST_READING: replay.last_reading(), LAST_MOTION: replay.last_motion()}
            for name, (own, law) in compared.items():
                drive = choose_drive(flight, own)
                fmu = Path(place, f"{name.replace(' ', '_')}_{drive}.fmu")
                if not fmu.exists():
                    export(twin(own, drive=drive, force=law, observer=name == UNTRAINED), fmu)
                watch = (DISTANCE,) if name == SHIPPED else ()
                driven = replay if own is vehicle else replay.driven_as(flight, own)
                flown[name] = driven.through(fmu, watch=watch)
                done += 1
                progress(done / total)
            rows += [row for name, off in flown.items() for row in _rows(name, flight.name, off)]
            near = np.mean(flown[SHIPPED].watched[..., 0] <= 1, axis=0)
            inside[flight.name] = tuple(near.tolist())
            windows[flight.name] = len(flown[SHIPPED].t_s)
            by_flight[flight.name] = flown
    noise = hover_levels(flights, vehicle, force)
    progress(1.0)
    return ForceEvaluation(model, pd.DataFrame(rows), inside, windows, noise, by_flight)


def _rows(model: str, flight: str, flown: OpenLoop) -> list[dict[str, Any]]:
    """Table rows, one per horizon, quantity and axis."""
    rms = flown.rms
    return [
        {
            "model": model,
            "flight": flight,
            "horizon_s": horizon_s,
            "quantity": quantity,
            "axis": a,
            "unit": unit,
            "rms": float(rms[h, q, k]),
        }
        for h, horizon_s in enumerate(HORIZONS_S)
        for q, (quantity, unit) in enumerate(QUANTITIES)
        for k, a in enumerate(AXES)
    ]


def over(
    table: pd.DataFrame, model: str, other: str = EXPLAINED, horizon_s: float = CLAIMED_S
) -> "pd.Series":
    """Ratio of a twin's rms to that of another, by flight, quantity and axis; without cells where
    the other's is zero."""
    at = table[table["horizon_s"] == horizon_s]
    rms = at.pivot(index=["flight", "quantity", "axis"], columns="model", values="rms")
    return rms[model] / rms[other].where(rms[other] > 0)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Table with one row per twin and horizon: rms per quantity over three axes and all flights,
    and median and largest ratio over its cells to the explained twin."""
    rows = []
    for (model, horizon_s), part in table.groupby(["model", "horizon_s"], sort=False):
        square = (part["rms"] ** 2).groupby(part["quantity"]).mean()
        ratios = over(table, str(model), horizon_s=float(horizon_s))
        rows.append(
            {
                "model": model,
                "horizon_s": horizon_s,
                **{q: float(np.sqrt(len(AXES) * square[q])) for q, _ in QUANTITIES},
                "over_explained_median": float(ratios.median()),
                "over_explained_largest": float(ratios.max()),
            }
        )
    return pd.DataFrame(rows)


def shown_table(table: pd.DataFrame) -> TextTable:
    """`summary` at the horizon `CLAIMED_S`."""
    rows = summary(table)
    header = (f"off after {CLAIMED_S:g} s", *(f"{q} {unit}" for q, unit in QUANTITIES))
    return TextTable(
        (*header, "over the vehicle file, median", "largest", "over the observer, median"),
        tuple(
            (
                SHOWN.get(row["model"], row["model"]),
                *(number(row[q]) for q, _ in QUANTITIES),
                f"{row['over_explained_median']:.2f}",
                f"{row['over_explained_largest']:.2f}",
                f"{over(table, row['model'], UNTRAINED).median():.2f}",
            )
            for row in rows[rows["horizon_s"] == CLAIMED_S].to_dict("records")
        ),
    )


def page_text(found: ForceEvaluation) -> str:
    """Report of an evaluation as HTML."""
    rows = summary(found.table)
    figure = horizons_figure(rows, QUANTITIES)
    return render(
        "force_evaluation.html.j2",
        claim=found.claim,
        model=found.model,
        flights=[
            {
                "name": name,
                "inside": dict(zip(HORIZONS_S, shares, strict=True)),
                "windows": found.windows[name],
            }
            for name, shares in found.inside.items()
        ],
        quantities=QUANTITIES,
        rows=rows.to_dict("records"),
        shown=SHOWN,
        figure=plot("horizons", "How far twins are off after they were left alone", figure),
    )
