"""Evaluation: a compensator and trivial baselines on new flights."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fmus.compensator import FILE
from learning.data.channels import CHANNELS, UNITS
from learning.data.flights import ResidualFlight, read_residuals, residuals_of, restart_before_s
from learning.data.scaling import in_spans
from learning.evaluation import WHOLE, evaluate, pooled
from learning.model.compensator import LINEAR_PART, Compensator
from learning.model.family import Corrected, Model, TrainedModel, TrainingTask
from learning.model.folder import load
from twin.formatting import counted, percent
from twin.logs import Flight
from twin.residuals.teacher_forced import choose_drive
from twin.vehicle import Vehicle as TwinVehicle

from ..display import PageMixin, TextTable
from ..exports.parts import learned
from ..flights import check_names, check_untaught
from ..record import Record
from ..report.drawing import Budget, fitted
from ..report.learning_figures import anomaly_figure, correction_figure
from ..report.page import Plot, plot, render
from ..series.files import (
    CORRECTED,
    EXPLAINED,
    MEASURED,
    SPREAD,
    TWIN,
    Column,
    Series,
    compared,
)
from ..series.files import MODEL as OF_MODEL
from ..vehicles import Vehicle, load_vehicle
from .in_use import InUseRecord, UsedFlight, driven_fmu, record_of
from .running import compiled_compensator
from .training import RESIDUALS, VEHICLE_FILE, in_use_of, task_text

Array = NDArray[np.float64]
MODEL = "model"
"""Name of the compensator in tables with the baselines."""
Progress = Callable[[float], None]


class AnomalyRecord(Record, frozen=True, kw_only=True):
    """Anomaly score on a flight; null for a model without one.

    Attributes:
        flight: Name of the flight.
        share_above_1: Share of samples with a score above 1, the alarm threshold.
        largest: Largest score.
        at_s: Time of the largest score, s.
    """

    flight: str
    share_above_1: float | None
    largest: float | None
    at_s: float | None


class EvaluationRecord(Record, frozen=True, kw_only=True):
    """Evaluation of a sensor compensator on other flights.

    Attributes:
        family: Model family.
        runs: Implementation that was evaluated: `fmu`, the exported one, or `python` for a family
            without FMU.
        protocol: Protocol: the data that the compensator saw.
        horizon: Age of the newest residual that it saw, samples.
        horizon_s: Age of the newest residual that it saw, s.
        rate_hz: Sample rate, Hz.
        vehicle: Vehicle that was compensated.
        flights: Names of the flights.
        claim: Summary sentence of the report.
        groups: Errors per sensor: the compensator against its linear part alone and the trivial
            baselines.
        channels: Errors per channel, with the same columns.
        anomaly: Anomaly score of each flight.
        in_use: Errors in the exported FMU of the driven twin at every reading, with those of the
            last and the mean reading; null except for `free`. `groups` and `channels` refer to
            prepared rows, along which the twin follows the measured motion.
    """

    family: str
    runs: str
    protocol: str
    horizon: int
    horizon_s: float
    rate_hz: float
    vehicle: str
    flights: tuple[str, ...]
    claim: str
    groups: tuple[dict[str, Any], ...]
    channels: tuple[dict[str, Any], ...]
    anomaly: tuple[AnomalyRecord, ...]
    in_use: InUseRecord | None


@dataclass(frozen=True, repr=False)
class Evaluation(PageMixin):
    """A model and its results on flights.

    Attributes:
        model: The compensator.
        table: Table of `learning.evaluation.evaluate`: one row per model, flight, phase and
            channel.
        flights: Residuals against the model's own vehicle.
        explained: Sensor readings of another vehicle's twin on the same grid, by flight; or None.
        corrected: Corrections, by flight.
        runs: Implementation that was run: "fmu", or "python" for a family without FMU.
        in_use: Errors in the exported twin; None except for `free`.
    """

    model: TrainedModel
    table: pd.DataFrame
    flights: tuple[ResidualFlight, ...]
    explained: tuple[ResidualFlight, ...] | None
    corrected: tuple[Corrected, ...]
    runs: str
    in_use: InUseRecord | None = None
    page: ClassVar[str] = __name__

    @property
    def claim(self) -> str:
        """Where the model beats the best trivial baseline, and where it does not, in one
        sentence."""
        what = _task(self.model)
        if self.in_use is not None:
            return f"{what}: {self.in_use.claim}."
        if self.model.info.protocol == "reconstruct":
            return (
                f"{what}: the model sees the measurement it repeats; holding that measurement "
                "itself leaves nothing, and no model can beat it."
            )
        better, worse = [], []
        for group, part in by_group(self).groupby("group", sort=False):
            own = float(part.loc[part["model"] == MODEL, "rmse"].iloc[0])
            best = float(part.loc[~part["model"].isin((MODEL, LINEAR_PART)), "rmse"].min())
            if own < best:
                better.append(f"{group} by {percent(1 - own / best)}")
            elif own > best:
                over = f"by {percent(own / best - 1)}" if best else "(baseline exact)"
                worse.append(f"{group} {over}")
        sides = {"better than the best trivial baseline": better, "worse": worse}
        text = "; ".join(f"{how} for {', '.join(some)}" for how, some in sides.items() if some)
        return f"{what}: {text or 'as good as the best trivial baseline everywhere'}."

    def frame(self) -> pd.DataFrame:
        """Table with one row per model, flight, phase and channel."""
        return self.table.copy()

    def series(self) -> tuple[Series, ...]:
        """Time series of each flight: measured, twin, corrected twin and residual at every new
        reading, with the model's own spread, anomaly score and envelope."""
        return tuple(_series(self, i) for i in range(len(self.flights)))

    @cached_property
    def record(self) -> EvaluationRecord:
        """All numbers that are printed, as a record."""
        info = self.model.info
        return EvaluationRecord(
            family=self.model.family,
            runs=self.runs,
            protocol=info.protocol,
            horizon=info.horizon,
            horizon_s=info.horizon / info.rate_hz,
            rate_hz=info.rate_hz,
            vehicle=info.vehicle,
            flights=tuple(f.name for f in self.flights),
            claim=self.claim,
            groups=tuple(by_group(self).to_dict("records")),
            channels=tuple(self.table.to_dict("records")),
            anomaly=tuple(
                AnomalyRecord(flight=f.name, **_anomaly(f, c))
                for f, c in zip(self.flights, self.corrected, strict=True)
            ),
            in_use=self.in_use,
        )

    def findings(self) -> Iterable[str | TextTable]:
        """Summary sentence, and table of errors in use, or of each model on prepared rows."""
        yield self.claim
        yield evaluation_table(self) if self.in_use is None else self.in_use.table()

    def brief(self) -> str:
        """Protocol and flights, as one line."""
        flights = counted(self.flights, "flight")
        return f"{type(self).__name__}: {self.model.info.protocol}, {flights}"


def _series(found: Evaluation, i: int) -> Series:
    """Time series of one flight; readings are those resampled to the grid, as they are scored."""
    flight, corrected = found.flights[i], found.corrected[i]
    columns: list[Column] = []
    for c, (channel, unit) in enumerate(zip(CHANNELS, UNITS, strict=True)):
        fresh = flight.fresh[:, c]
        if not fresh.any():
            continue
        t_s, sides = flight.t_s[fresh], _sides(found, i, c)
        columns += compared(channel, unit, t_s, sides.pop(MEASURED), sides)
        columns.append(Column(f"{SPREAD}.{channel}", unit, t_s, corrected.spread[fresh, c]))
    inside = corrected.inside.astype(np.float64)
    for name, values in (("anomaly", corrected.anomaly), ("inside", inside)):
        columns.append(Column(f"{OF_MODEL}.{name}", "1", flight.t_s, values))
    info = found.model.info
    facts = {"verb": "evaluate", "vehicle": info.vehicle, "model": found.model.family}
    return Series(flight.name, tuple(columns), {**facts, "task": _task(found.model)})


def _sides(found: Evaluation, i: int, c: int) -> dict[str, Array]:
    """Fresh samples of a channel in a flight: measured, and predicted by each twin."""
    flight = found.flights[i]
    fresh = flight.fresh[:, c]
    virtual = flight.virtual[fresh, c]
    sides = {MEASURED: virtual + flight.residual[fresh, c], TWIN: virtual}
    if found.explained is not None:
        sides[EXPLAINED] = found.explained[i].virtual[fresh, c]
    return sides | {CORRECTED: virtual + found.corrected[i].correction[fresh, c]}


def evaluate_model(
    folder: Path, given: Sequence[Flight], explained: TwinVehicle | None, progress: Progress
) -> Evaluation:
    """Compare, correct and score flights; the correction runs in the exported FMU, where the family
    has one.

    Args:
        folder: Folder that `train` wrote.
        given: Flights, none of which is a training flight.
        explained: Vehicle whose twin is drawn with the model's.
        progress: Called with the share done, 0..1.

    Raises:
        TwinError: The folder is no model, a flight was used in its training or cannot be compared.
    """
    model = load(folder)
    train = read_residuals(folder / RESIDUALS)
    vehicle = load_vehicle(folder / VEHICLE_FILE)
    check_names(given)
    check_untaught(given, folder, {f["log_sha256"]: f["name"] for f in model.info.flights})
    vehicles = [vehicle] if explained is None else [vehicle, explained]
    rate_hz = model.info.rate_hz
    before_s = restart_before_s(model.info.protocol, model.info.horizon, rate_hz)
    residuals: list[tuple[ResidualFlight, ...]] = []
    for each in vehicles:

        def share(done: float, before: int = len(residuals)) -> None:
            progress((before + done) / len(vehicles))

        residuals.append(residuals_of(given, each, rate_hz, before_s, share))
    flights = residuals[0]
    compiled = (folder / FILE).is_file()
    if compiled:
        with compiled_compensator(folder) as fmu:
            said = _StoredCorrections({f.name: fmu.run(f) for f in flights})
    else:
        said = _StoredCorrections({f.name: model.run(f) for f in flights})
    task = TrainingTask(model.info.protocol, model.info.horizon)
    in_use = _in_use(folder, vehicle, given) if compiled and task.protocol == "free" else None
    return Evaluation(
        model=model,
        table=evaluate(_own(model) | {MODEL: said}, train, flights, task),
        flights=flights,
        explained=residuals[1] if len(residuals) > 1 else None,
        corrected=tuple(said.corrected.values()),
        runs="fmu" if compiled else "python",
        in_use=in_use,
    )


def _in_use(folder: Path, vehicle: Vehicle, given: Sequence[Flight]) -> InUseRecord:
    """Errors of flights in the exported twin."""
    trained, (network, law) = in_use_of(folder), learned(folder)
    found = []
    for drive, flights in groupby(given, lambda f: choose_drive(f, vehicle)):
        with driven_fmu(vehicle, drive, network, law) as fmu:
            found += [UsedFlight(f, vehicle).corrections(fmu) for f in flights]
    return record_of(found, "other", () if trained is None else trained.shut)


def _own(model: TrainedModel) -> dict[str, Model]:
    """Parts of the model without its network, such as its linear predictor, where it has one."""
    alone = model.without_network() if isinstance(model, Compensator) else None
    return {} if alone is None else {LINEAR_PART: alone}


@dataclass(frozen=True, slots=True)
class _StoredCorrections:
    """Stored corrections of flights, by name, with the interface of a model."""

    corrected: Mapping[str, Corrected]

    def run(self, flight: ResidualFlight) -> Corrected:
        """Corrections of a flight."""
        return self.corrected[flight.name]


def by_group(found: Evaluation) -> pd.DataFrame:
    """Table with one row per sensor and model, over all flights and phases."""
    whole = found.table[found.table["phase"] == WHOLE]
    return pooled(whole, ("group", "unit", "model"))


def _task(model: TrainedModel) -> str:
    info = model.info
    return task_text(info.protocol, info.horizon, info.rate_hz)


def evaluation_table(found: Evaluation) -> TextTable:
    """Rms error of each model, one row per sensor, and coverage of the model's own spread."""
    table = by_group(found)
    names = list(dict.fromkeys(table["model"]))
    rows = []
    for group, part in table.groupby("group", sort=False):
        cells = part.set_index("model")
        unit, n = str(cells["unit"].iloc[0]), str(int(cells["n"].iloc[0]))
        own = cells.loc[MODEL]
        shares = (percent(own[k]) for k in ("within_1", "within_2", "inside"))
        rows.append((str(group), unit, n, *(f"{cells['rmse'][k]:.3g}" for k in names), *shares))
    header = ("rms left", "unit", "n", *names, "in 1 spread", "in 2", "inside")
    return TextTable(header, tuple(rows))


def _anomaly(flight: ResidualFlight, corrected: Corrected) -> dict[str, Any]:
    """How often the anomaly score is an alarm, and where it is largest.

    Empty for a model without alarms.
    """
    if np.isnan(corrected.anomaly).any():
        return {"share_above_1": None, "largest": None, "at_s": None}
    inside = in_spans(flight)
    score = np.where(inside, corrected.anomaly, 0.0)
    worst = int(np.argmax(score))
    return {
        "share_above_1": float(np.mean(score[inside] > 1)) if inside.any() else None,
        "largest": float(score[worst]),
        "at_s": float(flight.t_s[worst]),
    }


def page_text(found: Evaluation) -> str:
    """Report of an evaluation as HTML."""
    return fitted(lambda budget: _page(found, budget), len(found.flights))


def _page(found: Evaluation, budget: Budget) -> str:
    """Text of the report within a size budget."""
    rows = by_group(found)
    return render(
        "evaluation.html.j2",
        claim=found.claim,
        in_use=found.in_use,
        info=found.model.info,
        task=_task(found.model),
        explained=found.explained is not None,
        models=list(dict.fromkeys(rows["model"])),
        groups=[
            {
                "name": g,
                "unit": part["unit"].iloc[0],
                "n": int(part["n"].iloc[0]),
                "rows": part.set_index("model").to_dict("index"),
            }
            for g, part in rows.groupby("group", sort=False)
        ],
        flights=[_flight(found, i, budget) for i in range(len(found.flights))[: budget.parts]],
        further=len(found.flights[budget.parts :]),
    )


def _flight(found: Evaluation, i: int, budget: Budget) -> dict[str, Any]:
    """One flight as variables of the template."""
    flight, corrected = found.flights[i], found.corrected[i]
    figures: list[Plot] = []
    for c, channel in enumerate(CHANNELS):
        fresh = flight.fresh[:, c]
        if not fresh.any():
            continue
        named = {EXPLAINED: "explained twin", CORRECTED: "corrected twin"}
        lines = {named.get(side, side): values for side, values in _sides(found, i, c).items()}
        spread, time = corrected.spread[fresh, c], f"flight-{i}"
        figure = correction_figure(
            channel, UNITS[c], flight.t_s[fresh], lines, spread, time, budget
        )
        label = f"{channel} of {flight.name}: measured, twins, and what is left, over time"
        figures.append(plot(f"f{i}-{channel}", label, figure))
    return {
        "id": f"flight-{i}",
        "name": flight.name,
        "notes": flight.notes,
        "inside": float(np.mean(corrected.inside[flight.spans[0][0] : flight.spans[-1][1]])),
        "anomaly": _anomaly(flight, corrected),
        "score": _score(i, flight, corrected, budget),
        "figures": figures,
    }


def _score(i: int, flight: ResidualFlight, corrected: Corrected, budget: Budget) -> Plot | None:
    """Figure of the anomaly score; None for a model without one."""
    if np.isnan(corrected.anomaly).any():
        return None
    figure = anomaly_figure(flight.t_s, corrected.anomaly, f"flight-{i}", budget)
    return plot(f"f{i}-anomaly", f"Anomaly score of {flight.name} over time", figure)
