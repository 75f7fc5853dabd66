"""The plants of the benchmark: who flies, and which effects each can hide."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

from ..hiding import FORCES, OUTSIDE, READINGS, Hidden
from .aircraft import AIRCRAFT, Aircraft
from .jsbsim import f450, f450_dynamics
from .own.physics import Dynamics, own_dynamics
from .third_party import CRAZYFLIES, crazyflie, crazyflie_dynamics

EFFECTS: dict[str, Hidden] = {h.name: h for h in (*FORCES, *READINGS, *OUTSIDE)}
_PAIRS = (
    ("mass_offset", "accel_bias"),
    ("cog_offset", "rotor_efficiency_loss"),
    ("induced_inflow", "rotor_drag"),
    ("motor_lag", "imu_delay"),
    ("motor_lag", "command_delay"),
    ("rotor_drag", "thrust_tilt"),
    ("rotor_drag", "parasitic_drag"),
    ("rotor_drag", "steady_wind"),
    ("thrust_scale", "battery_sag"),
    ("thrust_scale", "translational_lift"),
    ("thrust_scale", "inertia_error"),
    ("mass_offset", "thrust_curve"),
    ("mass_offset", "slung_load"),
    ("mass_offset", "ground_effect"),
    ("cog_offset", "thrust_tilt"),
    ("cog_offset", "imu_lever_arm"),
    ("inertia_error", "motor_lag"),
    ("yaw_torque_scale", "rotor_inertia_torque"),
    ("position_delay", "rotor_drag"),
    ("accel_misalignment", "blade_flapping"),
    ("gyro_bias", "mag_hard_iron"),
    ("vibration", "accel_bias"),
    ("heading_offset", "baro_bias"),
    ("thrust_scale", "mag_current_coupling"),
)
"""Look-alikes, and neighbours that often come together."""
_TRIPLES = (
    ("mass_offset", "motor_lag", "accel_bias"),
    ("thrust_scale", "inertia_error", "mag_hard_iron"),
    ("rotor_drag", "cog_offset", "baro_bias"),
    ("mass_offset", "yaw_torque_scale", "imu_lever_arm"),
    ("thrust_scale", "motor_lag", "heading_offset"),
    ("rotor_drag", "rotor_efficiency_loss", "accel_misalignment"),
)
"""Three that may well come together: another build, a change of hardware, a bad calibration."""
_ONLY_OWN = {
    "induced_inflow",
    "translational_lift",
    "blade_flapping",
    "ground_effect",
    "thrust_curve",
    "gyroscopic_torque",
    "thrust_tilt",
}
"""What the dynamics of drone-models have no place for."""
_NOT_JSBSIM = {
    "translational_lift",
    "battery_sag",
    "motor_lag",
    "slung_load",
    "rotor_inertia_torque",
    "gyroscopic_torque",
}
"""What the F450 of JSBSim has no place for, or has with nothing hidden."""


@dataclass(frozen=True)
class Plant:
    """One simulator.

    Attributes:
        name: In the truth file.
        aircraft: Names, one after the other by seed.
        effects: Names of what can be hidden in it.
        seeds: Of each effect, magnitude and noise level.
        quiet_seeds: Of each noise level with nothing hidden.
        load: Aircraft and dynamics by the name of the aircraft.
        package: On PyPI; None for our own.
    """

    name: str
    aircraft: tuple[str, ...]
    effects: tuple[str, ...]
    seeds: int
    quiet_seeds: int
    load: Callable[[str], tuple[Aircraft, Dynamics]]
    package: str | None = None

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Pairs of effects that it can hide."""
        return [pair for pair in _PAIRS if {*pair} <= {*self.effects}]

    @property
    def triples(self) -> list[tuple[str, ...]]:
        """Three effects at once that it can hide."""
        return [triple for triple in _TRIPLES if {*triple} <= {*self.effects}]


PLANTS = {
    p.name: p
    for p in (
        Plant("own", tuple(AIRCRAFT), tuple(EFFECTS), 5, 40, lambda n: (AIRCRAFT[n], own_dynamics)),
        Plant(
            "drone_models",
            CRAZYFLIES,
            tuple(n for n in EFFECTS if n not in _ONLY_OWN),
            2,
            10,
            lambda n: (crazyflie(n), crazyflie_dynamics(n)),
            package="drone-models",
        ),
        Plant(
            "jsbsim",
            ("F450",),
            tuple(n for n in EFFECTS if n not in _NOT_JSBSIM),
            2,
            10,
            lambda n: (f450(), f450_dynamics()),
            package="jsbsim",
        ),
    )
}


def may_fly_together(plant: str, aircraft: str) -> tuple[str, ...]:
    """Aircraft that one simulation can hold along with this one."""
    if plant != "own":
        return (aircraft,)
    rotors = {name: len(a.nominal.hubs) for name, a in AIRCRAFT.items()}
    return tuple(b for a, b in product([aircraft], rotors) if rotors[a] == rotors[b])
