"""A trained compensator as it ships: its FMU, stepped over a flight."""

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
from learning.data.flights import ResidualFlight
from learning.model.family import Corrected

Array = NDArray[np.float64]
_KINDS = ("correction", "spread")


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
        """The whole flight; each span starts anew."""
        network, n = self.network, flight.virtual.shape[1]
        correction = np.zeros((len(flight.t_s), n))
        spread = np.tile(np.array(network.uncorrected_rms), (len(flight.t_s), 1))
        anomaly, inside = np.zeros(len(flight.t_s)), np.zeros(len(flight.t_s), dtype=np.bool_)
        names, table = fed(network, flight)
        reads, period = outputs_of(network), 1 / flight.rate_hz
        slave = Slave("compensator", self.fmu)
        try:
            sent, received = np.zeros(len(names)), np.zeros(len(reads))
            slave.bind(names, reads, sent, received)
            for a, b in flight.spans:
                slave.initialize(0.0, {})
                slave.finish_initialization()
                for row in range(a, b):
                    slave.inputs[:] = table[row]
                    slave.write_inputs()
                    slave.step((row - a) * period, period)
                    slave.read_outputs()
                    correction[row], spread[row] = np.split(slave.outputs[: 2 * n], 2)
                    anomaly[row], inside[row] = slave.outputs[2 * n], slave.outputs[-1] > 0
                slave.reset()
        finally:
            slave.close()
        return Corrected(correction, spread, anomaly, inside)


def fed(network: NetworkFile, flight: ResidualFlight | None) -> tuple[list[str], Array]:
    """Inputs of a compensator's FMU, and their values along a flight, shape (n, inputs).

    Args:
        network: The compensator.
        flight: None: the names alone.
    """
    names = [*network.channels, *network.commands, "phase"]
    if network.sees_measurements:
        names += [f"measured.{c}" for c in network.channels]
        names += [f"valid.{g}" for g in network.groups]
    if flight is None:
        return names, np.zeros((0, len(names)))
    known = np.isfinite(flight.virtual).any(axis=0)  # a twin reads the others, too
    given = [np.where(known, flight.virtual, 0.0), flight.commands, flight.phase[:, None]]
    if network.sees_measurements:
        first = [network.group_of_channel.index(g) for g in range(len(network.groups))]
        given += [flight.virtual + flight.residual, flight.fresh[:, first]]
    return names, np.hstack(given).astype(np.float64)


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
