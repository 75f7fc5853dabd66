"""The whole twin: components of one vehicle, and their connections.

One definition serves the fused FMU, the `.ssp` with one FMU per part, and the scenarios.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import casadi as ca
import numpy as np

from ..component import Component, unknown_name
from ..effects import EFFECTS, RandomForce, effects_for
from ..errors import ModelError
from ..physics.airframe import airframe
from ..physics.battery import battery
from ..physics.environment import environment
from ..physics.residual_force import ForceLaw, residual_force
from ..physics.rotors import Drive
from ..physics.sensors.position import Kind, position_sensor
from ..physics.sensors.table import components_of_sensors
from ..representation import ShortRepr
from ..vehicle import Vehicle
from .closed_loop import standing
from .lqr import controller
from .mission import mission, mission_duration_s
from .px4 import px4_controller

DRIVEN_S = 10.0
"""Default duration of a driven twin, s."""
CONTROLLERS: dict[str, Callable[[Vehicle], Component]] = {
    "lqr": controller,
    "px4": px4_controller,
}
"""Flight controllers by name."""


@dataclass(frozen=True, slots=True)
class Choices:
    """Options of a component in addition to the vehicle.

    Attributes:
        effects: Effects to build in, switched off, as blocks of parameters: identifiers of
            `twin.effects.EFFECTS`.
        drive: Inputs of the airframe; None: what the vehicle describes.
        position: Kind of position sensor.
        mission: Name of the mission.
    """

    effects: tuple[str, ...] = ()
    drive: Drive | None = None
    position: Kind = "gnss"
    mission: str = "hover"


Maker = Callable[[Vehicle, Choices], Component]


def _sensor(make: Callable[[Vehicle, Iterable[str]], Component]) -> Maker:
    return lambda vehicle, choices: make(vehicle, choices.effects)


def _controller(make: Callable[[Vehicle], Component]) -> Maker:
    return lambda vehicle, _: make(vehicle)


SENSED = (*components_of_sensors(), "position")
"""Names of the components that are sensors."""
COMPONENTS: Mapping[str, Maker] = {
    "airframe": lambda v, c: airframe(v, c.drive, c.effects),
    **{name: _sensor(make) for name, make in components_of_sensors().items()},
    "position": lambda v, c: position_sensor(v, c.effects, c.position),
    "battery": lambda v, _: battery(v),
    "environment": lambda v, _: environment(v),
    "mission": lambda v, c: mission(v, c.mission),
    **{
        "controller" if name == "lqr" else f"controller_{name}": _controller(make)
        for name, make in CONTROLLERS.items()
    },
}
"""Every component of the twin by its name, for export, assembly and documentation."""


@dataclass(frozen=True, slots=True)
class Assembly(ShortRepr):
    """Connected components of a co-simulation.

    Attributes:
        parts: Components by name.
        connections: ("part.output", "part.input") pairs.
        duration_s: Default duration of a simulation.
    """

    parts: Mapping[str, Component]
    connections: tuple[tuple[str, str], ...]
    duration_s: float

    def with_starts(self, starts: Mapping[str, float]) -> "Assembly":
        """The assembly with other start values, "part.variable" -> value.

        Raises:
            ModelError: There is no such part or variable, or a value is outside its range.
        """
        parts = dict(self.parts)
        for name, value in starts.items():
            part, _, variable = name.partition(".")
            if part not in parts or not variable:
                raise ModelError(unknown_name("start value", "part", part, parts))
            parts[part] = parts[part].with_starts({variable: value})
        return replace(self, parts=parts)

    def seed_starts(self, seed: int) -> dict[str, float]:
        """Start values with a seed for every part that draws noise."""
        return {
            f"{name}.seed": float(seed)
            for name, part in self.parts.items()
            if any(v.name == "seed" for v in part.parameters)
        }


def wind_starts(wind_m_s: Iterable[float], gusts: bool = False) -> dict[str, float]:
    """Start values of the air: a steady wind, velocity NED, with gusts or without."""
    names = (f"environment.wind.{a}" for a in "xyz")
    return dict(zip(names, wind_m_s, strict=True)) | gust_switches(gusts)


def responds_to_wind(twin: Assembly) -> bool:
    """Whether the motion of any part depends on the velocity of the air.

    Drag, flapping or inflow may be zero in the vehicle's file: then wind has no effect at all. The
    derivatives are compared with and without wind at random states, which detects any dependence
    that is not identically zero with probability 1.
    """
    rng = np.random.default_rng(0)
    for part in twin.parts.values():
        wind = [i for i, name in enumerate(part.input_names) if name.startswith("wind_")]
        p, u = part.parameter_values(), part.input_values()
        rest = np.ravel(ca.DM(part.initial(u, p)).full())
        for _ in range(4 if wind else 0):
            x, blown = rest + rng.normal(0.0, 3.0, rest.shape), u.copy()
            blown[wind] += rng.normal(0.0, 3.0, len(wind))
            with_wind, without = (ca.DM(part.derivatives(x, v, p)).full() for v in (blown, u))
            if not np.array_equal(with_wind, without, equal_nan=True):
                return True
    return False


def gust_switches(on: bool) -> dict[str, float]:
    """Start values that enable or disable gusts in an assembly."""
    blown = (e for e in EFFECTS.values() if isinstance(e.observable_as, RandomForce))
    return {f"{e.component}.{e.name}.enabled": float(on) for e in blown}


def flying_twin(
    vehicle: Vehicle,
    scenario: str = "hover",
    control: str = "lqr",
    effects: Iterable[str] | None = None,
    law: ForceLaw | None = None,
    position: Kind = "gnss",
) -> Assembly:
    """A vehicle with its sensors that flies a mission, starting on the ground.

    The controller reads the true motion; the sensors are only recorded.

    Args:
        vehicle: Numbers of the aircraft, and the effects that are switched on.
        scenario: Name of the mission.
        control: Name of the controller in `CONTROLLERS`.
        effects: Effects to build in, switched off, as blocks of parameters; None: `effects_for`
            the vehicle.
        law: Residual force and moment of its equations; None: no law is known.
        position: Kind of position sensor.

    Raises:
        ModelError: There is no such mission or controller.
    """
    if control not in CONTROLLERS:
        raise ModelError(unknown_name("flying twin", "controller", control, CONTROLLERS))
    built_in = effects_for(vehicle) if effects is None else tuple(effects)
    choices = Choices(built_in, None, position, scenario)
    body = COMPONENTS["airframe"](vehicle, choices)
    parts = {
        "mission": COMPONENTS["mission"](vehicle, choices),
        "controller": CONTROLLERS[control](vehicle),
        **_aircraft(vehicle, body, choices, law),
    }
    if vehicle.battery is not None:
        parts["battery"] = COMPONENTS["battery"](vehicle, choices)
    return Assembly(parts, connected_by_name(parts), mission_duration_s(scenario))


def driven_twin(
    vehicle: Vehicle,
    drive: Drive,
    effects: Iterable[str] | None = None,
    law: ForceLaw | None = None,
    position: Kind = "gnss",
    accuracy: Component | None = None,
) -> Assembly:
    """A vehicle with its sensors whose rotor inputs are external, as from a log.

    It starts on the ground. Commands or rotor speeds and the battery voltage are inputs, and so are
    those by which `twin.physics.airframe.airframe` resets its motion.

    Args:
        vehicle: Numbers of the aircraft, and the effects that are switched on.
        drive: Kind of the rotor inputs.
        effects: Effects to build in, switched off, as blocks of parameters; None: `effects_for`
            the vehicle.
        law: Residual force and moment of its equations; None: no law is known.
        position: Kind of position sensor.
        accuracy: Component from `twin.physics.accuracy` to include; None: without.

    Raises:
        ModelError: The vehicle's maps do not allow this input.
    """
    choices = Choices(effects_for(vehicle) if effects is None else tuple(effects), drive, position)
    body = airframe(vehicle, drive, choices.effects, restart=True, voltage=law is not None)
    parts = _aircraft(vehicle, body, choices, law)
    if accuracy is not None:
        parts[accuracy.name] = accuracy
    return Assembly(parts, connected_by_name(parts), DRIVEN_S)


def _aircraft(
    vehicle: Vehicle, body: Component, choices: Choices, law: ForceLaw | None
) -> dict[str, Component]:
    """The air, an airframe on the ground, the residual force, and the sensors."""
    beyond = {} if law is None else {"residual_force": residual_force(vehicle, law)}
    return {
        "environment": COMPONENTS["environment"](vehicle, choices),
        "airframe": body.with_starts(standing(body, vehicle)),
        **{name: COMPONENTS[name](vehicle, choices) for name in SENSED},
        **beyond,
    }


class Ports(Protocol):
    """Object with named inputs and outputs: a component, the model of an FMU."""

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs, in order."""


def connected_by_name(parts: Mapping[str, Ports]) -> tuple[tuple[str, str], ...]:
    """Connections of each input to the one other part with an output of its name, if there is one.

    Raises:
        ModelError: Two parts have an output with the name of an input.
    """
    giver: dict[str, str] = {}
    wanted = {name for part in parts.values() for name in part.input_names}
    for key, part in parts.items():
        for output in part.output_names:
            if output in wanted and output in giver:
                raise ModelError(f"{giver[output]} and {key} both give {output}; connect by hand.")
            giver[output] = key
    return tuple(
        (f"{giver[name]}.{name}", f"{key}.{name}")
        for key, part in parts.items()
        for name in part.input_names
        if name in giver and giver[name] != key
    )
