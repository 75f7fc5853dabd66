"""Signals that might have been: what a model of the protocol `generate` draws.

    uavtwin train FLIGHT... --protocol generate --model innovations --vehicle V --out MODEL
    python -m benchmarks.paper.generated fly MODEL --mission tour --seed 1 --out tour.parquet
    python -m benchmarks.paper.generated evaluate MODEL FLIGHT... --out DIR

The first flies a mission with the model's own vehicle and adds the draws to accelerometer,
gyroscope and magnetometer, each as often as it was logged. The second compares draws with flights
that took no part in the training, by distribution and spectrum, alongside white noise,
autoregressions and a training flight played back: DIR/evaluation.json, DIR/report.html.
"""

import argparse
import json
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from learning import metrics
from learning.data.channels import CHANNELS, GROUPS, N_PHASES, UNITS
from learning.data.flights import ResidualFlight, read_residuals, residual_flight, restart_before_s
from learning.evaluation import GROUP_OF, WHOLE, cells, check_finite, check_flights, residual_scale
from learning.model.baselines import by_phase, phase_means
from learning.model.family import Corrected, Model, TrainedModel
from learning.model.folder import MODEL as MODEL_JSON
from learning.model.folder import WEIGHTS, load
from twin.errors import TwinError
from twin.flight.closed_loop import STEP_S, closed_loop
from twin.flight.mission import PHASES
from twin.flight.simulate_flight import Recorder, Stream, simulate_flight
from twin.formatting import number, pretty_unit
from twin.logs import Flight, read_flight, write_flight
from twin.logs.columns import ACC, GYRO, MAG, POS, QUAT, VEL, motor_columns
from twin.residuals.gap import spectrum
from twin.vehicle import Vehicle
from twin.vehicle_file import load_vehicle
from uavtwin.compensators.evaluation import check_new
from uavtwin.compensators.training import RESIDUALS, VEHICLE_FILE
from uavtwin.flights import check_names
from uavtwin.output import check_file, output_file, recorded_file
from uavtwin.report.drawing import Budget, Panels, fitted, thinned
from uavtwin.report.page import BLACK, ORANGE, Figure, Plot, plot, render

from .innovations import fit_generators

Array = NDArray[np.float64]
MODEL = "model"
RECORDED = "a training flight"
"""What the model, and a training flight played back, are called in the tables."""
RECORD_HZ = 200.0
DRAWN = {"acc": ACC, "gyro": GYRO, "mag": MAG}
"""Groups of channels that have a residual where the twin follows; where it is put has none."""


class Draws(Protocol):
    """A model that draws what might have been, of a seed."""

    def with_seed(self, seed: int) -> Model:
        """The same with these draws; it sees phases and span limits, and no measurement."""
        ...


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


def spectra_figure(
    names: Sequence[str], t_s: Array, lines: Mapping[str, Array], budget: Budget
) -> Figure:
    """Power spectra of several signals, a panel per channel.

    Args:
        names: Of the channels.
        t_s: Times of the samples, shape (n,).
        lines: By name, shape (n, channels).
        budget: Of the page.
    """
    panels = Panels((150,) * len(names))
    for i, name in enumerate(names):
        last = i == len(names) - 1
        along = {"type": "log", "dtick": 1}
        if last:
            along["title"] = {"text": "frequency, Hz"}
        axes = panels.add(f"{name}: PSD", along, {"type": "log", "exponentformat": "power"})
        for (line, values), colour in zip(lines.items(), (BLACK, ORANGE), strict=True):
            found = spectrum(t_s, values[:, i])
            keep = (found.f_hz > 0) & (found.psd > 0)
            f, psd = np.log10(found.f_hz[keep]), np.log10(found.psd[keep])
            f, psd = thinned(f, psd, budget.spectrum)
            panels.line(axes, 10**f, 10**psd, line, {"color": colour, "width": 1.2})
    return panels.figure


@dataclass(frozen=True, slots=True)
class GeneratedEvaluation:
    """What a model draws, and flights that it has not seen.

    Attributes:
        model: The generator.
        table: As `benchmarks.paper.generated.evaluate_generated` gives it.
        flights: Residuals against the model's own vehicle.
        drawn: One draw of each.
    """

    model: TrainedModel
    table: pd.DataFrame
    flights: tuple[ResidualFlight, ...]
    drawn: tuple[Array, ...]

    @property
    def claim(self) -> str:
        """How near its draws come, alongside Gaussian innovations and another flight."""
        rows = self._means().set_index(["group", "model"])["log_spectral_db"]
        groups = list(dict.fromkeys(g for g, _ in rows.index))
        best = [g for g in groups if rows[g, MODEL] <= min(rows[g, n] for n in self._others())]
        nearer = f"nearest of all for {', '.join(best)}" if best else "nowhere nearest of all"
        return (
            f"generate: spectra of its draws are {nearer}; {RECORDED} stands for what is possible."
        )

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
            Path(__file__).parent,
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


def evaluate_drawn(folder: Path, given: Sequence[Flight]) -> GeneratedEvaluation:
    """Compare draws with flights, alongside other generators and a training flight played back.

    Args:
        folder: That `uavtwin train --protocol generate` wrote.
        given: Flights; none of the training.

    Raises:
        TwinError: The folder holds no model that draws, or a flight was trained on.
    """
    model = _drawing(folder)
    draws, train = cast(Draws, model), read_residuals(folder / RESIDUALS)
    vehicle = load_vehicle(folder / VEHICLE_FILE)
    check_names(given)
    check_new(given, folder, model)
    before_s = restart_before_s("generate", 0, model.info.rate_hz)
    flights = [residual_flight(f, vehicle, model.info.rate_hz, before_s) for f in given]
    makers = {n: g.with_seed for n, g in fit_generators(train).items()}
    recording = fit_recording(train).with_seed
    table = evaluate_generated(
        {**makers, RECORDED: recording, MODEL: draws.with_seed}, train, flights
    )
    drawn = tuple(draws.with_seed(0).run(f).correction for f in flights)
    return GeneratedEvaluation(model, table, tuple(flights), drawn)


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = table.to_dict("records")
    return [
        {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}
        for row in rows
    ]


# ----------------------------------------------------------------------------------------
# Evaluation of generated residuals: by distribution and spectrum, never sample by sample.
#
# A generator is right when nobody can tell its signals from measured ones; a draw that agreed with
# the flight sample by sample would be chance. One row is one channel of one flight in one phase
# ("all": the whole flight) and one seed:
#
# | column | says |
# |---|---|
# | wasserstein, wasserstein_std | distance of the distributions; in units of the training spread |
# | spread, spread_measured | rms about the mean |
# | log_spectral_db | root mean square difference of the power spectra |
# | band_db | mean absolute difference of the power in the frequency bands |
# | measured B, generated B | power in frequency band B, Hz |

SEEDS = (0, 1, 2)


def evaluate_generated(
    models: Mapping[str, Callable[[int], Model]],
    train: Sequence[ResidualFlight],
    test: Sequence[ResidualFlight],
    seeds: Sequence[int] = SEEDS,
) -> pd.DataFrame:
    """Score generators.

    Args:
        models: By name; each makes a model of a seed. A training flight played back (`recording`)
            tells how alike two real flights are.
        train: What standardised units are made from.
        test: Flights to compare with.
        seeds: Of the draws.

    Returns:
        One row per model, seed, flight, phase and channel.
    """
    check_flights(train, test)
    scale = residual_scale(train)
    rows: list[dict[str, Any]] = []
    for name, make in models.items():
        for seed in seeds:
            model = make(seed)
            for flight in test:
                corrected = model.run(flight)
                check_finite(name, flight, corrected)
                head = {"protocol": "generate", "model": name, "seed": seed, "flight": flight.name}
                rows += [head | r for r in _rows(flight, corrected.correction, scale)]
    return pd.DataFrame(rows)


def _rows(flight: ResidualFlight, generated: Array, scale: Array) -> Iterator[dict[str, Any]]:
    for phase, c, channel, here in cells(flight):
        measured, made = flight.residual[here, c], generated[here, c]
        size, t_s = scale[flight.phase[here], c], flight.t_s[here]
        powers = [metrics.band_powers(t_s, v) for v in (measured, made)]
        yield {
            "phase": phase,
            "channel": channel,
            "group": GROUP_OF[channel],
            "unit": UNITS[c],
            "n": len(made),
            "wasserstein": metrics.wasserstein(measured, made),
            "wasserstein_std": metrics.wasserstein(measured / size, made / size),
            "spread": metrics.spread_of(made),
            "spread_measured": metrics.spread_of(measured),
            "log_spectral_db": metrics.log_spectral_distance(t_s, measured, made),
            "band_db": metrics.band_distance(*powers),
            **{f"measured {b}": float(p) for b, p in zip(metrics.BANDS, powers[0], strict=True)},
            **{f"generated {b}": float(p) for b, p in zip(metrics.BANDS, powers[1], strict=True)},
        }


# ----------------------------------------------------------------------------------------
# Residuals of a training flight played back: how alike two real flights are, and no more.


@dataclass(frozen=True, slots=True)
class Recording:
    """Plays pieces of training flights in the same phase.

    Attributes:
        mean: Of the residual by phase, shape (phases, 15); said where no flight had the phase.
        scale: Spread about it, shape (phases, 15).
        pieces: By phase, the residual of each training flight in it, shape (n_i, 15).
        seed: Of which piece is played, and from where.
    """

    mean: Array
    scale: Array
    pieces: tuple[tuple[Array, ...], ...]
    seed: int = 0

    def with_seed(self, seed: int) -> "Recording":
        """The same recordings, played from elsewhere."""
        return replace(self, seed=seed)

    def run(self, flight: ResidualFlight) -> Corrected:
        """Each stretch of one phase from a piece drawn again, begun again where it ends."""
        rng = np.random.default_rng([self.seed, zlib.crc32(flight.name.encode())])
        correction = self.mean[flight.phase]
        for a, b in flight.spans:
            edges = a + 1 + np.flatnonzero(np.diff(flight.phase[a:b]))
            for rows in np.split(np.arange(a, b), edges - a):
                pieces = self.pieces[flight.phase[rows[0]]]
                if pieces:
                    piece = pieces[int(rng.integers(len(pieces)))]
                    start = int(rng.integers(len(piece)))
                    correction[rows] = piece[(start + np.arange(len(rows))) % len(piece)]
        n = len(flight.t_s)
        return Corrected(
            correction, self.scale[flight.phase], np.full(n, np.nan), np.ones(n, dtype=np.bool_)
        )


def fit_recording(train: Sequence[ResidualFlight]) -> Recording:
    """Cut training flights into phases."""
    mean = phase_means(train)
    scale = np.sqrt(by_phase(train, [(f.residual - mean[f.phase]) ** 2 for f in train]))
    pieces: list[list[Array]] = [[] for _ in range(N_PHASES)]
    for flight in train:
        rows = np.concatenate([np.arange(a, b) for a, b in flight.spans])
        residual = np.where(np.isfinite(flight.residual), flight.residual, mean[flight.phase])[rows]
        for p in range(N_PHASES):
            part = residual[flight.phase[rows] == p]
            if len(part):
                pieces[p].append(part)
    return Recording(mean, scale, tuple(tuple(p) for p in pieces))


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    fly, evaluate = verbs.add_parser("fly"), verbs.add_parser("evaluate")
    for verb in (fly, evaluate):
        verb.add_argument("model", type=Path, help="folder that `uavtwin train` wrote")
        verb.add_argument("--out", type=Path, required=True)
    fly.add_argument("--mission", default="hover", help="hover, takeoff, tour, forward or land")
    fly.add_argument("--seed", type=int, default=0, help="of all that is drawn")
    fly.add_argument("--force", action="store_true", help="replace an existing file")
    evaluate.add_argument("flights", type=Path, nargs="+", help="none of the training")
    given = parser.parse_args(arguments)
    if given.verb == "fly":
        check_file(given.out, given.force)
        flight = generated_flight(given.model, given.mission, given.seed)
        inputs = [given.model / n for n in (VEHICLE_FILE, MODEL_JSON, WEIGHTS)]
        options = {"model": given.model.name, "mission": given.mission}
        with recorded_file(given.out, given.force) as (file, note):
            write_flight(flight, file)
            note("generate", options, inputs, given.seed)
        return 0
    found = evaluate_drawn(given.model, [read_flight(f) for f in given.flights])
    given.out.mkdir(parents=True, exist_ok=True)
    content = json.dumps(found.json(), indent=1, allow_nan=False)
    (given.out / "evaluation.json").write_text(f"{content}\n", "utf-8")
    found.report(given.out / "report.html")
    print(found.claim)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
