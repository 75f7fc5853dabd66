"""A trained compensator as it ships, in the C of its FMU: stepped over a flight, and in flight.

In flight its inputs are computed by the functions of its training, on the last seconds of the
stream, so that a recording gives the same numbers (`CompiledCompensator`). That takes 0.2 s of
processor, whence the long `EVERY_S`.
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
"""Outputs per channel that are read."""


@dataclass(frozen=True, slots=True)
class CompiledCompensator:
    """A compensator in C; it says what the model itself says, in the arithmetic of the FMU.

    Attributes:
        fmu: FMU.
        network: That it was made from.
    """

    fmu: Path
    network: NetworkFile

    def run(self, flight: ResidualFlight) -> Corrected:
        """The whole flight; each span starts from zero."""
        network, n = self.network, flight.virtual.shape[1]
        correction = np.zeros((len(flight.t_s), n))
        spread = np.tile(np.array(network.uncorrected_rms), (len(flight.t_s), 1))
        alarms, inside = network.protocol == "track", np.zeros(len(flight.t_s), dtype=np.bool_)
        anomaly = np.zeros(len(flight.t_s)) if alarms else no_alarm(len(flight.t_s))
        table, stepping = fed(network, flight), Stepping(self.fmu, network)
        try:
            for a, b in flight.spans:
                stepping.begin()
                said = np.array([stepping.step(row) for row in table[a:b]])
                correction[a:b], spread[a:b] = said[:, :n], said[:, n : 2 * n]
                inside[a:b] = said[:, -1] > 0
                if alarms:
                    anomaly[a:b] = said[:, 2 * n]
        finally:
            stepping.close()
        return Corrected(correction, spread, anomaly, inside)


class Stepping:
    """A compensator's FMU, a sample after the other; `close` frees it."""

    def __init__(self, fmu: Path, network: NetworkFile) -> None:
        """Load it; `begin` comes next."""
        names, reads = inputs_of(network), outputs_of(network)
        self._period_s, self._row = 1 / network.rate_hz, 0
        self._slave = Slave("compensator", fmu)
        self._slave.bind(names, reads, np.zeros(len(names)), np.zeros(len(reads)))

    def begin(self) -> None:
        """From the state zero."""
        self._slave.reset()
        self._slave.initialize(0.0, {})
        self._slave.finish_initialization()
        self._row = 0

    def step(self, given: Array) -> Array:
        """Outputs, as `outputs_of`, after a sample of inputs, as `inputs_of`."""
        self._slave.inputs[:] = given
        self._slave.write_inputs()
        self._slave.step(self._row * self._period_s, self._period_s)
        self._slave.read_outputs()
        self._row += 1
        return self._slave.outputs.copy()

    def close(self) -> None:
        """Free the FMU."""
        self._slave.close()


def inputs_of(network: NetworkFile) -> list[str]:
    """Inputs of a compensator's FMU."""
    names = [*network.channels, *network.commands, "phase"]
    if network.sees_measurements:
        names += [f"measured.{c}" for c in network.channels]
        names += [f"valid.{g}" for g in network.groups]
    return names


def fed(network: NetworkFile, flight: ResidualFlight) -> Array:
    """`inputs_of` a compensator along a flight, shape (n, inputs)."""
    known = np.isfinite(flight.virtual).any(axis=0)  # a twin reads the others, too
    given = [np.where(known, flight.virtual, 0.0), flight.commands, flight.phase[:, None]]
    if network.sees_measurements:
        first = [network.group_of_channel.index(g) for g in range(len(network.groups))]
        given += [flight.virtual + flight.residual, flight.fresh[:, first]]
    return np.hstack(given).astype(np.float64)


def outputs_of(network: NetworkFile) -> list[str]:
    """Outputs that are read: corrections, spreads, `anomaly`, `inside`."""
    return [*(f"{kind}.{c}" for kind in _KINDS for c in network.channels), "anomaly", "inside"]


@contextmanager
def compiled_compensator(folder: Path) -> Iterator[CompiledCompensator]:
    """The compensator of a folder, built for as long as it is needed.

    Args:
        folder: Of a trained model that has a `model.onnx`.

    Raises:
        FmuError: The folder holds none, or the C generator refuses it.
    """
    network = read_network(folder)
    with tempfile.TemporaryDirectory() as place:
        fmu = build(native_model(network), Path(place, "compensator.fmu"))
        yield CompiledCompensator(fmu, network)


EVERY_S = 2.0
"""Of flight, between two evaluations, s."""


@dataclass(frozen=True, slots=True)
class Correction:
    """What a compensator says of a part of a flight, a row per sample of its own rate.

    Attributes:
        t_s: Of the flight, shape (n,).
        residual: Measured less twin, NaN where nothing was measured again, shape (n, channels).
        correction: To be added to what the twin reads, the same shape.
        anomaly: How strange the newest residuals are that it sees, above 1 rarely, shape (n,).
        inside: Whether the flight is where training has been, shape (n,).
    """

    t_s: Array
    residual: Array
    correction: Array
    anomaly: Array
    inside: NDArray[np.bool_]


class RunningCompensator:
    """One flight; `close` frees the FMU.

    Attributes:
        network: The compensator.
        horizon_s: How old the newest residual is that it sees, s; infinite: it sees none.
        status: What it said of the flight so far.
    """

    def __init__(self, fmu: Path, network: NetworkFile, vehicle: Vehicle) -> None:
        """Nothing was flown yet.

        Args:
            fmu: Of the compensator.
            network: That it was made from.
            vehicle: The twin.
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
        """A new flight."""
        self._until_s = self._last_s = -np.inf
        self._rows = self._unusual = self._inside = 0
        n = len(self.network.channels)
        self._samples, self._before, self._after = np.zeros(n), np.zeros(n), np.zeros(n)
        self.status = ModelStatus(self.horizon_s)

    def update(
        self, flight: Flight, until_s: float, aligned: AlignedFlight | None = None
    ) -> Correction | None:
        """What it says of what is new; None: it is not time yet, or nothing was in the air.

        Args:
            flight: The last seconds, from at least two before what is new.
            until_s: Up to where the flight is told.
            aligned: The flight on the grid of the twin; None: it is put there.
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
        except LogError:  # nothing in the air to compare
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
        """Take a part into what is told of the flight."""
        known = np.isfinite(new.residual)
        left = new.residual - new.correction
        self._samples += known.sum(axis=0)
        self._before += np.sum(np.where(known, new.residual, 0.0) ** 2, axis=0)
        self._after += np.sum(np.where(known, left, 0.0) ** 2, axis=0)
        self._rows += len(new.t_s)
        self._unusual += int((new.anomaly > 1.0).sum())
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
        """Step it over rows, from zero where they do not follow on the row before."""
        period_s, n = 1 / self.network.rate_hz, len(self.network.channels)
        table, said = fed(self.network, seen), []
        for k in rows:
            if abs(seen.t_s[k] - self._last_s - period_s) > 0.1 * period_s:
                self._stepping.begin()
            said.append(self._stepping.step(table[k]))
            self._last_s = float(seen.t_s[k])
        shown = np.array(said)
        residual = np.where(seen.fresh[rows], seen.residual[rows], np.nan)
        return Correction(seen.t_s[rows], residual, shown[:, :n], shown[:, 2 * n], shown[:, -1] > 0)

    def close(self) -> None:
        """Free the FMU."""
        self._stepping.close()
