"""Accuracy of a driven twin: its error bands since its motion was last given, and their range of
validity.

Four quantities describe the motion since then, each by its maximum:

    airspeed    |v - v_wind|, m/s
    rates       |omega|, rad/s
    thrust      |sum of thrusts / weight - 1|
    ground      `residual_force.nearness` to the ground

The envelope is the largest ratio of one of them to its limit: 1 at the limits of the flights with
which the twin was compared. There are two regimes, calm and lively, below and above a threshold. A
band is a table over regime and time without given motion, linear in time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from itertools import pairwise

import casadi as ca

from ..component import Component, ComponentBuilder
from ..errors import ModelError
from ..frames import AXES
from ..representation import ShortRepr
from ..vehicle import Vehicle
from .residual_force import nearness
from .sensors.table import SENSORS

PERIOD_S = 0.01
"""Time between two evaluations, s: a fifth of the shortest time alone that is compared."""
SEEN = (
    ("airspeed", "m/s", "speed through the air"),
    ("rates", "rad/s", "body rate"),
    ("thrust", "1", "thrust over weight, off 1"),
    ("ground", "1", "nearness to the ground"),
)
"""Quantities that determine the regime: name, unit, meaning."""
REGIMES = ("calm", "lively")
OFF = {
    **{"position": "m", "velocity": "m/s", "attitude": "rad", "rates": "rad/s"},
    **{s.name: s.plain_unit.replace("^", "") for s in SENSORS},
}
"""Errors of a twin, as lengths of vectors, and their units."""
OF_THE_DAY = "barometer"
"""Sensor whose reading depends on the weather of the day, which a vehicle file does not contain:
its parameter `ground_pressure` must be given for its band to be valid."""


@dataclass(frozen=True, slots=True)
class Bands(ShortRepr):
    """Measured errors of a twin as bands.

    Attributes:
        horizons_s: Times without given motion, s, ascending, shape (h,).
        limits: Limits of the quantities of `SEEN`, above 0, shape (4,).
        calm: Envelope up to which the regime is calm.
        bands: Band of each quantity, names from `OFF`, by regime and time: two rows of h numbers.
    """

    horizons_s: Sequence[float]
    limits: Sequence[float]
    calm: float
    bands: Mapping[str, Sequence[Sequence[float]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ModelError where shapes or numbers are invalid."""
        h = len(self.horizons_s)
        if h < 1 or not all(0 < a < b for a, b in pairwise((1e-9, *self.horizons_s))):
            raise ModelError(
                f"accuracy: times alone {list(self.horizons_s)} must be above 0, rising."
            )
        if len(self.limits) != len(SEEN) or not all(x > 0 for x in self.limits):
            raise ModelError(f"accuracy: limits {list(self.limits)} must be {len(SEEN)} above 0.")
        for name, rows in self.bands.items():
            if name not in OFF or [len(r) for r in rows] != [h] * len(REGIMES):
                raise ModelError(
                    f"accuracy: band of {name}: needs {len(REGIMES)} rows of {h} numbers and a "
                    f"name of {', '.join(OFF)}."
                )


def nowhere_valid(vehicle: Vehicle) -> Component:
    """Component for a twin that was not compared, or too little: its output is "not valid" only."""
    m = ComponentBuilder("accuracy", f"How far the twin of {vehicle.name} may be off: not known")
    m.output("valid", "1", "Whether the bands hold", 0.0, kind="boolean")
    return m.build()


def accuracy(vehicle: Vehicle, known: Bands | None = None) -> Component:
    """Component with the envelope of the motion so far and the resulting bands.

    Args:
        vehicle: Vehicle of the twin.
        known: Measured errors; None: it outputs only the quantities `seen.NAME`, from which bands
            are computed.
    """
    m = ComponentBuilder("accuracy", f"How far the twin of {vehicle.name} may be off")
    alone_s = m.input("alone", "s", "Time since the motion was given")
    now = _now(m, vehicle)
    period = m.sampled(PERIOD_S, "Time between two evaluations")
    seen = []
    for (name, unit, meaning), value in zip(SEEN, now, strict=True):
        before = m.memory(f"seen.{name}", unit, f"Largest {meaning}")
        seen.append(ca.if_else(alone_s < period, value, ca.fmax(before, value)))
        m.update(f"seen.{name}", seen[-1])
        if known is None:
            m.output(f"seen.{name}", unit, f"Largest {meaning} since the motion was given", before)
    if known is not None:
        _judged(m, known, alone_s, period, seen)
    return m.build()


def _now(m: ComponentBuilder, vehicle: Vehicle) -> list[ca.SX]:
    """Values of `SEEN` at an instant."""
    vel_n = [m.input(f"vel_{a}", "m/s", f"Velocity, NED {a}") for a in AXES]
    wind_n = [m.input(f"wind_{a}", "m/s", f"Velocity of the air, NED {a}") for a in AXES]
    omega_b = [m.input(f"omega_{a}", "rad/s", f"Body rate about {a}") for a in AXES]
    weight = m.parameter(
        "weight", vehicle.mass_kg * vehicle.gravity_m_s2, "N", "Of the vehicle file", minimum=1e-3
    )
    thrust = [
        m.input(f"thrust_{i}", "N", f"Thrust of rotor {i}")
        for i in range(1, vehicle.rotors.count + 1)
    ]
    down = m.input("pos_z", "m", "Position, NED down", -100.0)
    ground = m.parameter("ground.z", 0.0, "m", "Ground plane, NED down")
    air = [v - w for v, w in zip(vel_n, wind_n, strict=True)]
    airspeed, rates = (ca.sqrt(sum((v * v for v in x), start=ca.SX(0))) for x in (air, omega_b))
    off = ca.fabs(sum(thrust, start=ca.SX(0)) / weight - 1)
    return [airspeed, rates, off, nearness(ground - down, vehicle.arm_m)]


def _judged(
    m: ComponentBuilder, known: Bands, alone_s: ca.SX, period: ca.SX, seen: Sequence[ca.SX]
) -> None:
    """Declare the outputs: validity of the bands, and the bands, held between instants."""
    holds = m.parameter(
        "known",
        1.0,
        "1",
        "Whether this twin was compared with flights",
        kind="boolean",
        minimum=0,
        maximum=1,
    )
    limits = [
        m.parameter(f"limit.{name}", limit, unit, f"Largest {meaning} that was compared", minimum=0)
        for (name, unit, meaning), limit in zip(SEEN, known.limits, strict=True)
    ]
    calm = m.parameter("calm", known.calm, "1", "Envelope up to which the regime is calm")
    times = [
        m.parameter(f"time_{i}", t, "s", f"Time alone {i} of the bands", minimum=0)
        for i, t in enumerate(known.horizons_s, start=1)
    ]
    used = reduce(ca.fmax, [x / limit for x, limit in zip(seen, limits, strict=True)])
    valid = ca.logic_and(holds > 0.5, ca.logic_and(used <= 1, alone_s < times[-1] + period / 2))
    shares = [ca.fmin(ca.fmax((alone_s - a) / (b - a), 0.0), 1.0) for a, b in pairwise(times)]
    _held(m, "valid", "1", "Whether the bands hold", valid, boolean=True)
    _held(m, "envelope", "1", "Largest share of a limit that was reached since it is alone", used)
    for name, rows in known.bands.items():
        unit = OFF[name]
        calm_band, lively_band = (
            _along(
                [
                    m.parameter(
                        f"band.{name}.{regime}_{i}",
                        x,
                        unit,
                        f"Of {name}, {regime}, at time {i}",
                        minimum=0,
                    )
                    for i, x in enumerate(row, start=1)
                ],
                shares,
            )
            for regime, row in zip(REGIMES, rows, strict=True)
        )
        off = ca.if_else(used <= calm, calm_band, lively_band)
        about = f"95 % of the times {name} was off by no more than this, where valid"
        if name == OF_THE_DAY:
            about += " and ground_pressure is that of the day"
        _held(m, f"error_95.{name}", unit, about, off)


def _along(band: Sequence[ca.SX], shares: Sequence[ca.SX]) -> ca.SX:
    """A band at the present time without given motion: linear between its times, the first value
    before them."""
    steps = (s * (b - a) for (a, b), s in zip(pairwise(band), shares, strict=True))
    return sum(steps, start=band[0])


def _held(
    m: ComponentBuilder, name: str, unit: str, about: str, value: ca.SX, boolean: bool = False
) -> None:
    """An output that changes only at sample instants."""
    held = m.memory(f"{name}.held", unit, f"{name} at the last evaluation")
    m.update(f"{name}.held", value)
    m.output(name, unit, about, held, kind="boolean" if boolean else "real")
