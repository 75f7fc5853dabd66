"""A trained compensator in its shipped form, the C code of its FMU: run over a recording, or live.

In flight its inputs are computed by the functions used in training, from the last seconds of the
stream, so that a recording gives the same numbers (`CompiledCompensator`). That takes 0.2 s of
processor time, hence the long `EVERY_S`.
"""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.slave import Slave
from fmus import build
from fmus.compensator import NetworkFile, native_model, read_network
from learning.data.flights import ResidualFlight, residual_flight, restart_before_s
from learning.model.family import Corrected, no_alarm
from twin.errors import LogError
from twin.logs import Flight
from twin.residuals.aligned import AlignedFlight
from twin.vehicle import Vehicle

from ..live.status import ModelStatus

Array = NDArray[np.float64]
_KINDS = ("correction", "spread")
"""Outputs per channel that are read, before `anomaly` and `inside`."""


@dataclass(frozen=True, slots=True)
class CompiledCompensator:
    """A compensator in C; its results are those of the model in the arithmetic of the FMU.

    Attributes:
        fmu: Path of the FMU.
        network: Network from which it was made.
    """

    fmu: Path
    network: NetworkFile

    def run(self, flight: ResidualFlight) -> Corrected:
        """Corrections of the whole flight; each span starts from zero state."""
        n, samples = flight.virtual.shape[1], len(flight.t_s)
        said = np.zeros((samples, len(_KINDS) * n + 2))
        said[:, n : 2 * n] = self.network.uncorrected_rms
        given = fed(self.network, flight)
        stepping = Stepping(self.fmu, self.network)
        try:
            for span in flight.spans:
                stepping.begin()
                rows = slice(*span)
                said[rows] = [stepping.step(row) for row in given[rows]]
        finally:
            stepping.close()
        correction, spread, anomaly, inside = np.split(said, [n, 2 * n, 2 * n + 1], axis=1)
        if self.network.protocol != "track":
            anomaly = no_alarm(samples)
        return Corrected(correction, spread, anomaly.ravel(), inside[:, 0] > 0)


class Stepping:
    """A compensator's FMU, stepped sample by sample; `close` frees it."""

    def __init__(self, fmu: Path, network: NetworkFile) -> None:
        """Load the FMU; call `begin` next."""
        self._period_s, self._row = 1 / network.rate_hz, 0
        self._slave = Slave("compensator", fmu)
        self._inputs = [n for n, port in self._slave.ports.items() if port.causality == "input"]
        outputs = [f"{kind}.{c}" for kind in _KINDS for c in network.channels]
        self._outputs = [*outputs, "anomaly", "inside"]

    def begin(self) -> None:
        """Reset to zero state."""
        self._slave.begin(self._inputs, self._outputs)
        self._row = 0

    def step(self, given: Array) -> Array:
        """Outputs after one sample of inputs, as of `fed`: `_KINDS`, `anomaly`, `inside`."""
        self._row += 1
        return self._slave.advance(given, (self._row - 1) * self._period_s, self._period_s)

    def close(self) -> None:
        """Free the FMU."""
        self._slave.close()


def fed(network: NetworkFile, flight: ResidualFlight) -> Array:
    """Inputs of a compensator's FMU along a flight, in the order of its interface, shape (n,
    inputs)."""
    known = np.isfinite(flight.virtual).any(axis=0)  # a twin predicts the others, too
    given = [np.where(known, flight.virtual, 0.0), flight.commands, flight.phase[:, None]]
    if network.sees_measurements:
        first = [network.group_of_channel.index(g) for g in range(len(network.groups))]
        given += [flight.virtual + flight.residual, flight.fresh[:, first]]
    return np.hstack(given).astype(np.float64)


@contextmanager
def compiled_compensator(folder: Path) -> Iterator[CompiledCompensator]:
    """The compensator of a folder, compiled, as a context manager.

    Args:
        folder: Folder of a trained model with a `model.onnx`.

    Raises:
        FmuError: The folder has no such file, or the C generator refuses it.
    """
    network = read_network(folder)
    with tempfile.TemporaryDirectory() as place:
        fmu = build(native_model(network), Path(place, "compensator.fmu"))
        yield CompiledCompensator(fmu, network)


EVERY_S = 2.0
"""Time of flight between two evaluations, s."""


@dataclass(frozen=True, slots=True)
class Correction:
    """Corrections for a part of a flight, one row per sample at the compensator's rate.

    Attributes:
        t_s: Time of flight, s, shape (n,).
        residual: Measured minus twin, shape (n, channels); NaN where there is no new measurement.
        correction: Correction to be added to the twin's readings, shape (n, channels).
        anomaly: Anomaly score of the newest residuals, rarely above 1, shape (n,); NaN: none.
        inside: Whether the flight is inside the training envelope, shape (n,).
    """

    t_s: Array
    residual: Array
    correction: Array
    anomaly: Array
    inside: NDArray[np.bool_]


class RunningCompensator:
    """A compensator along one live flight; `close` frees the FMU.

    Attributes:
        network: Network of the compensator.
        horizon_s: Age of the newest residual that it sees, s; infinite: it sees none.
        status: Summary of the corrections in the flight so far.
    """

    def __init__(self, fmu: Path, network: NetworkFile, vehicle: Vehicle) -> None:
        """Load the FMU; no sample is processed yet.

        Args:
            fmu: FMU of the compensator.
            network: Network from which it was made.
            vehicle: Vehicle of the twin.
        """
        self.network, self._vehicle = network, vehicle
        old_s = network.horizon / network.rate_hz
        self.horizon_s = old_s if network.sees_measurements else float("inf")
        self._restart_s = restart_before_s(
            network.protocol,  # type: ignore[arg-type]
            network.horizon,
            network.rate_hz,
        )
        self._stepping = Stepping(fmu, network)
        self.begin()

    def begin(self) -> None:
        """Begin a new flight."""
        self._until_s = self._last_s = -np.inf
        self._rows, self._unusual, self._inside = 0, 0.0, 0
        n = len(self.network.channels)
        self._samples, self._before, self._after = np.zeros(n), np.zeros(n), np.zeros(n)
        self.status = ModelStatus(self.horizon_s)

    def update(
        self, flight: Flight, until_s: float, aligned: AlignedFlight | None = None
    ) -> Correction | None:
        """Corrections for new samples; None: not due yet, or nothing was in the air.

        Args:
            flight: Last seconds of the flight, from at least two before the first new sample.
            until_s: Time up to which the flight is complete, s.
            aligned: The flight on the grid of the twin; None: it is resampled here.
        """
        if until_s - self._until_s < EVERY_S:
            return None
        after_s, self._until_s = self._until_s, until_s
        try:
            seen = residual_flight(
                flight,
                self._vehicle,
                self.network.rate_hz,
                self._restart_s,
                aligned=aligned,
            )
        except LogError:  # no samples in the air to compare
            return None
        rows = [
            k
            for a, b in seen.spans
            for k in range(a, b)
            if after_s + 1e-9 < seen.t_s[k] <= until_s + 1e-9
        ]
        if not rows:
            return None
        found = self._stepped(seen, np.array(rows, dtype=np.intp))
        self._count(found)
        return found

    def _count(self, new: Correction) -> None:
        """Add a part to the summary of the flight."""
        known = np.isfinite(new.residual)
        left = new.residual - new.correction
        self._samples += known.sum(axis=0)
        self._before += np.sum(np.where(known, new.residual, 0.0) ** 2, axis=0)
        self._after += np.sum(np.where(known, left, 0.0) ** 2, axis=0)
        self._rows += len(new.t_s)
        self._unusual += (
            float((new.anomaly > 1.0).sum()) if self.network.protocol == "track" else np.nan
        )
        self._inside += int(new.inside.sum())
        rms = {
            c: (float(np.sqrt(b / n)), float(np.sqrt(a / n)))
            for c, n, b, a in zip(
                self.network.channels, self._samples, self._before, self._after, strict=True
            )
            if n
        }
        self.status = ModelStatus(
            self.horizon_s,
            float(new.t_s[-1]),
            float(new.anomaly.max()),
            self._unusual / self._rows,
            self._inside / self._rows,
            rms,
        )

    def _stepped(self, seen: ResidualFlight, rows: NDArray[np.intp]) -> Correction:
        """Step it over rows; starts from zero state where they do not follow the row before."""
        period_s, n = 1 / self.network.rate_hz, len(self.network.channels)
        table, said = fed(self.network, seen), []
        for k in rows:
            if abs(seen.t_s[k] - self._last_s - period_s) > 0.1 * period_s:
                self._stepping.begin()
            said.append(self._stepping.step(table[k]))
            self._last_s = float(seen.t_s[k])
        shown = np.array(said)
        residual = np.where(seen.fresh[rows], seen.residual[rows], np.nan)
        anomaly = shown[:, 2 * n] if self.network.protocol == "track" else no_alarm(len(rows))
        return Correction(seen.t_s[rows], residual, shown[:, :n], anomaly, shown[:, -1] > 0)

    def close(self) -> None:
        """Free the FMU."""
        self._stepping.close()
