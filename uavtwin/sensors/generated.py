"""Signals that might have been: what a model of the protocol `generate` draws."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from learning.data.channels import CHANNELS, GROUPS, UNITS
from learning.data.flights import ResidualFlight, residual_flight, restart_before_s
from learning.data.residual_table import read_residuals
from learning.evaluation.generating import evaluate_generated
from learning.evaluation.protocols import WHOLE
from learning.model.family import Draws, TrainedModel
from learning.model.folder import load
from learning.model.generator import fit_generators
from learning.model.recording import fit_recording
from twin.errors import TwinError
from twin.flight.closed_loop import STEP_S, closed_loop
from twin.flight.mission import PHASES
from twin.flight.simulate_flight import Recorder, Stream, simulate_flight
from twin.logs import Flight
from twin.logs.columns import ACC, GYRO, MAG, POS, QUAT, VEL, motor_columns
from twin.vehicle import Vehicle
from twin.vehicle.file import load_vehicle

from ..display import DisplayMixin, TextTable
from ..formatting import counted, number, pretty_unit
from ..output import output_file
from ..report.drawing import Budget, fitted
from ..report.learning_figures import spectra_figure
from ..report.page import Plot, plot, render
from ..series.files import DRAWN as DRAWN_SIDE
from ..series.files import TWIN, Column, Series, compared
from .training import RESIDUALS, VEHICLE_FILE

Array = NDArray[np.float64]
MODEL = "model"
RECORDED = "a training flight"
"""What the model, and a training flight played back, are called in the tables."""
RECORD_HZ = 200.0
DRAWN = {"acc": ACC, "gyro": GYRO, "mag": MAG}
"""Groups of channels that have a residual where the twin follows; where it is put has none."""


def generated_flight(folder: Path, mission: str, seed: int) -> Flight:
    """Fly a mission with the twin, and draw what its sensors would have read besides.

    Args:
        folder: That `train(..., protocol="generate")` wrote; its vehicle is flown.
        mission: Name of the mission.
        seed: Of the draws: the same one, the same bytes.

    Returns:
        Commands, pose, velocity and rates as flown; accelerometer, gyroscope and magnetometer as
        often as in the training flights, with what was drawn.

    Raises:
        TwinError: The folder holds no such model, or there is no such mission.
    """
    draws = _drawing(folder)
    vehicle = load_vehicle(folder / VEHICLE_FILE)
    trained = read_residuals(folder / RESIDUALS)
    flown = _flown(vehicle, mission)
    seen = residual_flight(flown, vehicle, draws.info.rate_hz, restart_before_s("generate", 0, 1))
    if seen.commands.shape[1] != draws.info.n_commands:
        seen = replace(seen, commands=np.zeros((len(seen.t_s), draws.info.n_commands)))
    return _with_draws(
        flown, seen, cast(Draws, draws).with_seed(seed).run(seen).correction, trained
    )


def _drawing(folder: Path) -> TrainedModel:
    """The model of a folder, if it draws.

    Raises:
        TwinError: It does not.
    """
    model = load(folder)
    if model.info.protocol != "generate" or not hasattr(model, "with_seed"):
        raise TwinError(
            f"{folder}: was trained for the protocol {model.info.protocol}; what draws signals is "
            "trained by `uavtwin train --protocol generate --model innovations` or another of the "
            "models that can."
        )
    return model


def _flown(vehicle: Vehicle, mission: str) -> Flight:
    """A mission in still air, every sensor without noise."""
    plan = closed_loop(vehicle, mission)
    names = {code: phase for phase, code in PHASES.items()}
    phases = [names[int(code)] for code in np.round(plan.phase)]
    drives = motor_columns("cmd" if vehicle.drive == "command" else "rotor", vehicle.rotors.count)
    columns = (drives, ACC, GYRO, MAG, POS, VEL, QUAT)
    streams = tuple(Stream(c, 1 / RECORD_HZ) for c in columns)
    recorder = Recorder(streams, rate_hz=RECORD_HZ, sampled_hz=1 / STEP_S)
    return simulate_flight(plan.setpoints, phases, vehicle, vehicle, recorder, mission)


def _with_draws(
    flown: Flight, seen: ResidualFlight, drawn: Array, trained: Sequence[ResidualFlight]
) -> Flight:
    """The flight with sensors that read what was drawn besides, at their own instants."""
    table = flown.table.copy()
    t_s = table["time"].to_numpy()
    for group, columns in DRAWN.items():
        own = GROUPS[group]
        every = _every(trained, own)
        if every is None:
            table = table.drop(columns=[c for c in columns if c in table])
            continue
        instants = seen.t_s[::every]
        more = drawn[::every, own]
        rows = np.clip(np.searchsorted(t_s, instants - 1e-9), 0, len(t_s) - 1)
        clean = table[list(columns)].to_numpy()
        values = np.full_like(clean, np.nan)
        values[rows] = clean[rows] + more
        table[list(columns)] = values
    return Flight(flown.name, table, site=flown.site)


def _every(trained: Sequence[ResidualFlight], columns: slice) -> int | None:
    """Rows of the grid per sample of a sensor, as in the training; None where it has none."""
    gaps = [np.diff(np.flatnonzero(f.fresh[:, columns].all(axis=1))) for f in trained]
    between = np.concatenate(gaps) if gaps else np.zeros(0)
    return max(round(float(np.median(between))), 1) if len(between) else None


@dataclass(frozen=True, slots=True, repr=False)
class GeneratedEvaluation(DisplayMixin):
    """What a model draws, beside flights that it has not seen.

    Attributes:
        model: The generator.
        table: As `learning.evaluation.generating.evaluate_generated` gives it.
        flights: Residuals against the model's own vehicle.
        drawn: One draw of each.
    """

    model: TrainedModel
    table: pd.DataFrame
    flights: tuple[ResidualFlight, ...]
    drawn: tuple[Array, ...]

    @property
    def claim(self) -> str:
        """How near its draws come, beside Gaussian innovations and another flight."""
        rows = self._means().set_index(["group", "model"])["log_spectral_db"]
        groups = list(dict.fromkeys(g for g, _ in rows.index))
        best = [g for g in groups if rows[g, MODEL] <= min(rows[g, n] for n in self._others())]
        nearer = f"nearest of all for {', '.join(best)}" if best else "nowhere nearest of all"
        return (
            f"generate: spectra of its draws are {nearer}; {RECORDED} stands for what is possible."
        )

    def frame(self) -> pd.DataFrame:
        """A row per model, seed, flight, phase and channel."""
        return self.table.copy()

    def series(self) -> tuple[Series, ...]:
        """Of each flight measured, twin and one draw over time, at every new reading."""
        return tuple(self._series(i) for i in range(len(self.flights)))

    def json(self) -> dict[str, Any]:
        """The content of `evaluation.json`."""
        info = self.model.info
        return {
            "family": self.model.family,
            "runs": "python",
            "protocol": info.protocol,
            "horizon": info.horizon,
            "horizon_s": 0.0,
            "rate_hz": info.rate_hz,
            "vehicle": info.vehicle,
            "flights": [f.name for f in self.flights],
            "claim": self.claim,
            "groups": _records(self._means()),
            "channels": _records(self.table),
            "anomaly": [],
        }

    def report(self, path: str | Path) -> Path:
        """Write the page, one HTML file that opens offline; returns its path."""
        with output_file(Path(path)) as file:
            file.write_text(fitted(self._page, len(self.flights)), encoding="utf-8")
        return Path(path)

    def _page(self, budget: Budget) -> str:
        """Text of the page."""
        rows, shown = self._means(), range(len(self.flights))[: budget.parts]
        return render(
            "generated.html.j2",
            {"number": number, "unit": pretty_unit},
            claim=self.claim,
            info=self.model.info,
            models=list(dict.fromkeys(rows["model"])),
            groups=[
                {
                    "name": g,
                    "unit": p["unit"].iloc[0],
                    "rows": p.set_index("model").to_dict("index"),
                }
                for g, p in rows.groupby("group", sort=False)
            ],
            figures=[f for i in shown for f in self._figures(i, budget)],
            further=len(self.flights) - len(shown),
        )

    def sections(self) -> Iterable[str | TextTable]:
        """The claim, and how far the draws are off."""
        yield self.claim
        rows = self._means()
        names = list(dict.fromkeys(rows["model"]))
        lines = []
        for group, part in rows.groupby("group", sort=False):
            cells = part.set_index("model")
            said = (
                f"{cells['wasserstein_std'][n]:.2f}, {cells['log_spectral_db'][n]:.1f} dB"
                for n in names
            )
            lines.append((str(group), *said))
        yield TextTable(("distance of distribution (spreads), of spectrum", *names), tuple(lines))

    def brief(self) -> str:
        """Protocol and flights."""
        return f"{type(self).__name__}: generate, {counted(self.flights, 'flight')}"

    def _series(self, i: int) -> Series:
        """Columns of one flight."""
        flight = self.flights[i]
        columns: list[Column] = []
        for c, (channel, unit) in enumerate(zip(CHANNELS, UNITS, strict=True)):
            fresh = flight.fresh[:, c]
            virtual = flight.virtual[fresh, c]
            sides = {TWIN: virtual, DRAWN_SIDE: virtual + self.drawn[i][fresh, c]}
            measured = virtual + flight.residual[fresh, c]
            if fresh.any():
                columns += compared(channel, unit, flight.t_s[fresh], measured, sides)
        info = self.model.info
        facts = {"verb": "evaluate", "vehicle": info.vehicle, "model": self.model.family}
        return Series(flight.name, tuple(columns), {**facts, "task": info.protocol})

    def _others(self) -> list[str]:
        return [n for n in self.table["model"].unique() if n not in (MODEL, RECORDED)]

    def _means(self) -> pd.DataFrame:
        """Whole flights, a row per sensor and model."""
        whole = self.table[self.table["phase"] == WHOLE]
        columns = ["wasserstein", "wasserstein_std", "spread", "spread_measured", "log_spectral_db"]
        by = ["group", "unit", "model"]
        return whole.groupby(by, sort=False)[columns].mean().reset_index()

    def _figures(self, i: int, budget: Budget) -> list[Plot]:
        """Spectra of measured and drawn residuals of a flight, a figure per sensor."""
        flight, found = self.flights[i], []
        for group, columns in GROUPS.items():
            known = flight.fresh[:, columns].all(axis=1)
            if not known.any():
                continue
            figure = spectra_figure(
                CHANNELS[columns],
                flight.t_s[known],
                {
                    "measured": flight.residual[known, columns],
                    "drawn": self.drawn[i][known, columns],
                },
                budget,
            )
            label = f"Spectra of measured and drawn residuals of {flight.name}, {group}"
            found.append(plot(f"f{i}-{group}", label, figure))
        return found


def evaluate_drawn(
    model: TrainedModel,
    train: Sequence[ResidualFlight],
    flights: Sequence[ResidualFlight],
    progress: Callable[[float], None] = lambda _: None,
) -> GeneratedEvaluation:
    """Hold draws against flights, beside other generators and a training flight played back.

    Args:
        model: That draws.
        train: Flights of its training.
        flights: Others.
        progress: Called with the share done.
    """
    draws = cast(Draws, model)
    makers = {n: g.with_seed for n, g in fit_generators(train).items()}
    recording = fit_recording(train).with_seed
    table = evaluate_generated(
        {**makers, RECORDED: recording, MODEL: draws.with_seed}, train, flights
    )
    progress(1.0)
    drawn = tuple(draws.with_seed(0).run(f).correction for f in flights)
    return GeneratedEvaluation(model, table, tuple(flights), drawn)


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = table.to_dict("records")
    return [
        {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}
        for row in rows
    ]
