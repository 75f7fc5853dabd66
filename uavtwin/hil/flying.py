"""The aircraft of an autopilot: the whole twin as one FMU with external commands."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.slave import Slave
from cosim.whole_twin import COMPENSATOR, PHASE, fused_model
from fmus import build
from fmus.compensator import NetworkFile, native_model
from twin.errors import TwinError
from twin.flight.assembly import COMPONENTS, Assembly, Choices, connected_by_name
from twin.frames import AXES
from twin.physics.sensors.table import SENSORS
from twin.vehicle import Vehicle

from ..exports.parts import LearnedForce, check_unaided, twin
from ..simulation import Scenario, ineffective, shaping_starts

Array = NDArray[np.float64]
_MOTION = {
    "pos": [f"airframe.pos_{a}" for a in AXES],
    "vel": [f"airframe.vel_{a}" for a in AXES],
    "q": [f"airframe.q_{a}" for a in "wxyz"],
    "omega": [f"airframe.omega_{a}" for a in AXES],
    "force": [f"airframe.specific_force_{a}" for a in AXES],
    "wind": [f"environment.wind_{a}" for a in AXES],
    "gps_pos": [f"position.meas_pos_{a}" for a in AXES],
    "gps_vel": [f"position.meas_vel_{a}" for a in AXES],
}  # variables of the whole twin
_READINGS = {s.signal: (s.component, s.columns) for s in SENSORS if s.hil}
"""Component and columns of the signals sent to the autopilot."""


@dataclass(frozen=True, slots=True)
class TwinState:
    """State of the twin at one instant, SI, NED, FRD.

    Attributes:
        t_s: Simulated time.
        values: Values by signal: `acc`, `gyro`, `mag`, `baro` as measured, corrected where there is
            a compensator; `gps_pos`, `gps_vel` of the receiver; `pos`, `vel`, `q`, `omega`, `force`
            (specific force) of the true motion; `wind`.
    """

    t_s: float
    values: Mapping[str, Array]

    def __getitem__(self, signal: str) -> list[float]:
        """One signal."""
        numbers: list[float] = self.values[signal].tolist()
        return numbers


class FlyingTwin:
    """One instance of the fused FMU; `close` frees it."""

    def __init__(self, fmu: Path, starts: Mapping[str, float], corrected: Sequence[str]) -> None:
        """Load the FMU, on the ground at time 0.

        Args:
            fmu: FMU from `build_twin`.
            starts: Start values of its variables.
            corrected: Readings that its compensator corrects, by column.
        """
        self._slave = Slave("twin", fmu)
        names: dict[str, list[str]] = dict(_MOTION)
        for signal, (part, columns) in _READINGS.items():
            names[signal] = [
                f"{COMPENSATOR}.corrected.{c}" if c in corrected else f"{part}.{c}" for c in columns
            ]
        ports = self._slave.ports
        drives = [n for n in ports if n.startswith("airframe.cmd_")]
        self.motors = len(drives)
        outputs = [n for several in names.values() for n in several]
        edges = np.cumsum([0, *(len(several) for several in names.values())])
        self._parts = {n: slice(*edges[k : k + 2]) for k, n in enumerate(names)}
        self._commands, self._read = np.zeros(self.motors), np.zeros(len(outputs))
        try:
            self._slave.bind(drives, outputs, self._commands, self._read)
            self._slave.initialize(0.0, starts)
            self._slave.finish_initialization()
            self._slave.read_outputs()
        except BaseException:
            self._slave.close()
            raise
        self._t_s = 0.0

    def fly(self, commands: Sequence[float], until_s: float) -> TwinState:
        """Simulate with commands held.

        Args:
            commands: Commands of the motors, 0..1, shape (motors,).
            until_s: Simulated time to reach.

        Raises:
            TwinError: An output is not finite, or the FMU failed.
        """
        self._commands[:] = commands
        self._slave.write_inputs()
        self._slave.step(self._t_s, until_s - self._t_s)
        self._slave.read_outputs()
        if not np.isfinite(self._read).all():
            raise TwinError(
                f"the twin has no finite state any more at {until_s:g} s: it was flown out of what "
                f"its equations hold for."
            )
        self._t_s = until_s
        return self.now()

    def now(self) -> TwinState:
        """Present state."""
        read = self._read.copy()
        return TwinState(self._t_s, {name: read[part] for name, part in self._parts.items()})

    def close(self) -> None:
        """Free the instance."""
        self._slave.close()


def flying_twin_of(
    vehicle: Vehicle,
    folder: Path,
    scenario: Scenario | None = None,
    compensator: NetworkFile | None = None,
    force: LearnedForce | None = None,
    starts: Mapping[str, float] | None = None,
    warn: Callable[[str], None] = lambda _: None,
) -> FlyingTwin:
    """Build and load the twin of a vehicle, with its effects on.

    Args:
        vehicle: Vehicle of the twin.
        folder: Folder for its FMU.
        scenario: Wind, gusts, seed, effects, start values; None: still air.
        compensator: Compensator of its sensors, trained without measurements as inputs.
        force: Learned force and moment inside its equations.
        starts: Additional start values, "part.variable" -> value.
        warn: Called with each sentence from `uavtwin.simulation.ineffective`.

    Raises:
        TwinError: The vehicle has no motor commands, or a trained model is of another vehicle or
            needs the readings of an aircraft.
    """
    if vehicle.drive != "command":
        raise TwinError(
            f"{vehicle.name}: an autopilot gives motor commands, this vehicle is known by rotor "
            f"speed alone. Give it a map from commands: docs/guide/vehicle.md."
        )
    if compensator is not None:
        check_unaided(compensator)
    whole = twin(vehicle, compensator=compensator, drive="command", force=force)
    assembly = _with_battery(whole.assembly, vehicle)
    network = whole.compensator
    model = fused_model(assembly, vehicle.name, None if network is None else native_model(network))
    flown = scenario or Scenario("hil", vehicle)
    given = shaping_starts(assembly, flown) | dict(starts or {})
    for text in ineffective(assembly.with_starts(given), flown):
        warn(text)
    if network is not None and f"{COMPENSATOR}.{PHASE}" in model.input_names:
        given[f"{COMPENSATOR}.{PHASE}"] = float(max(network.phases.values()))  # unknown
    corrected = () if compensator is None else compensator.channels
    return FlyingTwin(build(model, folder / f"{model.name}.fmu"), given, corrected)


def _with_battery(assembly: Assembly, vehicle: Vehicle) -> Assembly:
    """The assembly with the vehicle's battery, where its file has one."""
    if vehicle.battery is None:
        return assembly
    parts = {**assembly.parts, "battery": COMPONENTS["battery"](vehicle, Choices())}
    return replace(assembly, parts=parts, connections=connected_by_name(parts))
