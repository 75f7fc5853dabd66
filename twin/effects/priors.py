"""What is expected of an effect before any flight: how often it is missing from a model, how large
it then is, and by how much it differs between flights.

One table. Numbers are in multiples of the parameter's `scale`, as its range is. They were written
down with RflySimDT's and NanoBench's flights in view and with none of the hidden-effects benchmark;
the reason of each row says where its size comes from.

| odds | log prior odds | for |
|---|---|---|
| UNMEASURED | -1 | numbers that nobody measures, and that are off on every aircraft |
| COMMON | -2.5 | what many aircraft have, and most files leave out |
| RARE | -4 | what needs a special cause |
| LAST | -7 | what would explain almost anything, and is thought of last |
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from ..vehicle import Vehicle
from .definition import Effect, EffectParameter

QUICKEST_LAG_S = 0.008
"""Smallest lag that a grid of 5 ms can tell from none."""
UNMEASURED, COMMON, RARE, LAST = -1.0, -2.5, -4.0, -7.0


@dataclass(frozen=True, slots=True)
class Normal:
    """What a number is expected to be where its effect is there.

    Attributes:
        mean: In the unit of the parameter over its `scale`.
        sd: Standard deviation.
        day: Standard deviation between flights of one aircraft; 0: all flights share the number.
    """

    mean: float
    sd: float
    day: float = 0.0

    def sized(self, parameter: EffectParameter, vehicle: Vehicle) -> "Normal":
        """The same with absolute numbers for a vehicle."""
        return self if parameter.scale is None else self.scaled(parameter.scale(vehicle))

    def scaled(self, k: float) -> "Normal":
        """The same in multiples of a number."""
        return Normal(k * self.mean, k * self.sd, k * self.day)


def nothing_yet(_: Vehicle) -> float:
    """Of a number that is a change of the model by itself."""
    return 0.0


def always_said(_: Vehicle) -> bool:
    """Of a cause of which a vehicle always says something."""
    return False


@dataclass(frozen=True, slots=True)
class Prior:
    """What is expected of an effect.

    Attributes:
        odds: Log prior odds that a model lacks it.
        reason: Where odds and sizes come from.
        numbers: By number of the effect, or by the beginning of its name; "" for all others.
        indoors: The same where the aircraft flies under a roof, of those that differ there.
        corrects: Key of the vehicle file that the effect puts right, "body.mass".
        start: Whether a calibration begins with it, however rare it is.
        timed: Whether its number moves signals in time though the effect is no shift of them: no
            linearisation tells such numbers apart.
        least: Smallest number that a flight can tell from none, for a vehicle; None: any.
        already: What a vehicle's own numbers hold of the quantity that `numbers` are about, in its
            unit: `numbers` are about the whole, a change of the model is the whole less this.
        unsaid: Whether a vehicle says nothing of the cause, so that it counts as unmeasured.
    """

    odds: float
    reason: str
    numbers: Mapping[str, Normal]
    indoors: Mapping[str, Normal] = field(default_factory=dict)
    corrects: str | None = None
    start: bool = False
    timed: bool = False
    least: Callable[[Vehicle], float | None] = field(default=lambda _: None, repr=False)
    already: Callable[[Vehicle], float] = field(default=nothing_yet, repr=False)
    unsaid: Callable[[Vehicle], bool] = field(default=always_said, repr=False)

    def change(self, whole: Normal, vehicle: Vehicle) -> Normal:
        """Distribution of the change of a vehicle's model, of that of the whole quantity.

        The vehicle's own number is evidence, too, good to a factor of two: half of it widens the
        distribution.
        """
        own = self.already(vehicle)
        return Normal(whole.mean - own, math.hypot(whole.sd, own / 2), whole.day)

    def odds_for(self, vehicle: Vehicle) -> float:
        """Log prior odds that a vehicle's model lacks the effect."""
        return max(self.odds, UNMEASURED) if self.unsaid(vehicle) else self.odds

    def of(self, name: str, indoors: bool) -> Normal:
        """Of a number of the effect, by the longest beginning of its name."""
        known = {**self.numbers, **self.indoors} if indoors else self.numbers
        return known[max((k for k in known if name.startswith(k)), key=len)]


PRIORS: dict[str, Prior] = {
    # -- between motor command and rotor wrench --------------------------------------------
    "thrust_scale": Prior(
        UNMEASURED,
        "maps come from other propellers: bench tests 10 to 30 % off, copied files 50 %",
        {"": Normal(1.0, 0.3)},
        corrects="rotors.thrust",
    ),
    "thrust_curve": Prior(
        RARE, "the shape of a map is better known than its size", {"": Normal(0.0, 0.15)}
    ),
    "battery_sag": Prior(
        COMMON,
        "slope 1 to 2 (Podhradsky et al. 2014) on every motor controller without compensation",
        {"slope": Normal(1.3, 0.6), "reference_v": Normal(1.0, 0.05)},
        unsaid=lambda v: not v.states_voltage,
    ),
    "motor_lag": Prior(
        UNMEASURED,
        "whole lag of all published airframes: 15 to 75 ms",
        {"": Normal(0.03, 0.015)},
        corrects="rotors.lag",
        already=lambda v: v.rotors.lag_up_s,
        timed=True,
        least=lambda v: None if v.rotors.follows else QUICKEST_LAG_S,
    ),
    "rotor_efficiency_loss": Prior(
        RARE,
        "propellers of one bag differ by 2 to 5 %, damaged blades cost up to 30 %; slower rotors "
        "lose torque as they lose thrust, damaged blades less of it, those of many simulators none",
        {"loss": Normal(0.0, 0.12), "torque_share": Normal(0.8, 0.5)},
    ),
    "rotor_inertia_torque": Prior(
        COMMON,
        "0.9 to 1.6 times the guess from thrust and arm: OS4 (Bouabdallah 2007), AR.Drone, "
        "Hummingbird, an F450, a quadrotor of 1.8 kg; Crazyflie by mass and radius of its blades",
        {"": Normal(1.0, 0.5)},
        corrects="rotors.reaction_inertia",
        unsaid=lambda v: not v.rotors.follows,
    ),
    "gyroscopic_torque": Prior(
        RARE,
        "the same momentum",
        {"": Normal(1.0, 0.5)},
        corrects="rotors.spin_inertia",
    ),
    "yaw_torque_scale": Prior(
        UNMEASURED,
        "torque coefficients are the least known numbers of a file",
        {"": Normal(1.0, 0.5)},
        corrects="rotors.torque",
    ),
    "thrust_tilt": Prior(COMMON, "1 to 2 degrees of frame and board", {"": Normal(0.0, 0.03)}),
    # -- mass and its place ----------------------------------------------------------------
    "mass_offset": Prior(
        COMMON, "battery, payload of up to 30 %", {"": Normal(0.0, 0.12)}, corrects="body.mass"
    ),
    "cog_offset": Prior(
        UNMEASURED,
        "place of the battery, put in anew before every flight",
        {"": Normal(0.0, 0.05, 0.015)},
        corrects="rotors.position",
    ),
    "inertia_error": Prior(
        UNMEASURED,
        "CAD or bifilar 5 to 10 % off, guessed 30 %",
        {"": Normal(1.0, 0.25)},
        corrects="body.inertia",
    ),
    "slung_load": Prior(
        RARE,
        "only where somebody hung one",
        {"mass_kg": Normal(0.0, 0.2), "length_m": Normal(0.7, 0.7)},
    ),
    # -- air -------------------------------------------------------------------------------
    "rotor_drag": Prior(
        COMMON,
        "0.1 to 0.5 1/s published; attacks within the height of motors and propellers; theory has "
        "it grow with rotor speed, identified models and simulators often leave that out",
        {
            "": Normal(0.2, 0.2),
            "height_m": Normal(0.0, 0.02),
            "spin_share": Normal(0.7, 0.4),
        },
    ),
    "parasitic_drag": Prior(RARE, "0.5 rho Cd A / m", {"": Normal(0.0, 0.03)}),
    "induced_inflow": Prior(
        RARE, "momentum theory: 1 / (2 v_i) to 1 / v_i", {"": Normal(0.05, 0.04)}
    ),
    "translational_lift": Prior(
        RARE, "Glauert", {"gain": Normal(0.0, 0.3), "induced_m_s": Normal(4.0, 2.0)}
    ),
    "blade_flapping": Prior(
        RARE,
        "stiff propellers tilt little",
        {"k_rad_s_m": Normal(0.005, 0.01), "height_m": Normal(0.03, 0.03)},
    ),
    "flapping_moment": Prior(RARE, "hub moment of stiff rotors", {"": Normal(0.0, 0.01)}),
    "steady_wind": Prior(
        COMMON,
        "up to 12 m/s is flown in; no mean vertical wind near the ground; indoors a draught",
        {"": Normal(0.0, 4.0, 2.0), "down_m_s": Normal(0.0, 0.3)},
        indoors={"": Normal(0.0, 0.1, 0.03), "down_m_s": Normal(0.0, 0.03)},
    ),
    "ground_effect": Prior(
        COMMON,
        "Cheeseman & Bennett 1955",
        {"gain": Normal(0.3, 0.2), "height_m": Normal(2.0, 1.0)},
    ),
    # -- sensors of the body ---------------------------------------------------------------
    "imu_lever_arm": Prior(
        UNMEASURED,
        "boards sit anywhere on the frame",
        {"": Normal(0.0, 0.25)},
        corrects="imu.position",
    ),
    "accel_scale": Prior(COMMON, "MEMS, data sheets 0.5 to 3 %", {"": Normal(1.0, 0.01)}),
    "gyro_scale": Prior(COMMON, "MEMS, data sheets 0.5 to 3 %", {"": Normal(1.0, 0.01)}),
    "accel_misalignment": Prior(COMMON, "mounting of the board", {"": Normal(0.0, 0.02)}),
    "accel_bias": Prior(
        COMMON, "zero-g offset of 20 to 60 mg, warmth", {"": Normal(0.0, 0.15, 0.1)}
    ),
    "gyro_bias": Prior(COMMON, "1 deg/s", {"": Normal(0.0, 0.015)}),
    # -- compass and barometer -------------------------------------------------------------
    "heading_offset": Prior(
        COMMON,
        "declination, frame of the motion capture, steel in floors",
        {"yaw_rad": Normal(0.0, 0.2, 0.15), "pose_rad": Normal(0.0, 0.2, 0.1)},
    ),
    "mag_soft_iron": Prior(
        COMMON,
        "5 %",
        {**{2 * a: Normal(1.0, 0.05) for a in "xyz"}, "": Normal(0.0, 0.05)},
    ),
    "mag_hard_iron": Prior(
        UNMEASURED, "up to the field itself where nobody calibrated", {"": Normal(0.0, 4e-5)}
    ),
    "mag_current_coupling": Prior(RARE, "ArduPilot's compassmot", {"": Normal(0.0, 3e-7)}),
    "baro_bias": Prior(
        UNMEASURED,
        "weather 10 hPa, altitude of the place",
        {"": Normal(0.0, 1500.0, 20.0)},
    ),
    "baro_dynamic_pressure": Prior(RARE, "static port", {"": Normal(0.0, 0.3)}),
    # -- clocks ----------------------------------------------------------------------------
    "imu_delay": Prior(COMMON, "filters, bus", {"": Normal(0.0, 0.008)}),
    "position_delay": Prior(
        COMMON, "motion capture 36 to 100 ms, GNSS 100 to 200 ms", {"": Normal(0.0, 0.05)}
    ),
    "command_delay": Prior(
        COMMON,
        "a loop and a frame of PWM; 10 to 30 ms where commands come by radio",
        {"": Normal(0.004, 0.012)},
        start=True,
    ),
    "clock_offset": Prior(
        LAST,
        "records put together from several clocks, each flight by itself; what an aircraft logs "
        "on board has one",
        {
            "": Normal(0.0, 0.03),
            "pose_s": Normal(0.0, 0.03, 0.02),
            "attitude_s": Normal(0.0, 0.03, 0.02),
        },
    ),
    "pose_smoothing": Prior(
        COMMON,
        "motion capture and smoothers average over some frames: 30 ms",
        {"": Normal(0.0, 9e-4)},
        start=True,
    ),
}


CHANGES: dict[str, Prior] = {
    "rotor_efficiency_loss": Prior(
        COMMON,
        "a nicked blade costs 5 to 30 % of its rotor's thrust",
        {"loss": Normal(0.1, 0.1), "torque_share": Normal(1.0, 0.3)},
    ),
    "mass_offset": Prior(COMMON, "payload of 5 to 25 %", {"": Normal(0.1, 0.1)}),
    "cog_offset": Prior(COMMON, "where it is strapped on", {"": Normal(0.0, 0.15)}),
    "inertia_error": Prior(COMMON, "it turns with the payload", {"": Normal(0.1, 0.1)}),
    "slung_load": Prior(
        RARE,
        "a load of 5 to 25 % on a rope",
        {"mass_kg": Normal(0.1, 0.1), "length_m": Normal(0.7, 0.7)},
    ),
    "steady_wind": Prior(
        COMMON,
        "weather",
        {"": Normal(0.0, 4.0), "down_m_s": Normal(0.0, 0.3)},
        indoors={"": Normal(0.0, 0.3), "down_m_s": Normal(0.0, 0.05)},
    ),
    "accel_bias": Prior(COMMON, "a sensor that was hit or warm", {"": Normal(0.0, 0.5)}),
    "gyro_bias": Prior(COMMON, "a sensor that was hit or warm", {"": Normal(0.0, 0.05)}),
    "imu_delay": Prior(RARE, "another filter", {"": Normal(0.0, 0.02)}),
    "position_delay": Prior(RARE, "another receiver", {"": Normal(0.0, 0.05)}),
    "command_delay": Prior(RARE, "another firmware", {"": Normal(0.0, 0.02)}),
    "heading_offset": Prior(
        COMMON, "steel nearby, a compass that was moved", {"": Normal(0.0, 0.3)}
    ),
}
"""What may change on an aircraft whose numbers are known, as changes of its numbers; whatever is
not here does not change from one flight to the next."""
BEGINNINGS: dict[str, Prior] = {
    **{e: CHANGES[e] for e in ("rotor_efficiency_loss", "mass_offset", "cog_offset")},
    **{e: CHANGES[e] for e in ("steady_wind", "accel_bias", "gyro_bias")},
    "battery_sag": Prior(
        COMMON,
        "a cell that fails or freezes: slope as of motor controllers without compensation",
        {"slope": Normal(1.3, 0.6), "reference_v": Normal(1.0, 0.05)},
    ),
    "motor_lag": Prior(RARE, "a bearing, a controller that is hot", {"": Normal(0.0, 0.03)}),
    "mag_hard_iron": Prior(
        COMMON, "a tenth to half of the earth's field: a magnet, steel", {"": Normal(0.0, 1e-5)}
    ),
    "baro_bias": Prior(COMMON, "a draught, a blocked port", {"": Normal(0.0, 100.0)}),
    "stuck_sensor": Prior(COMMON, "a sensor that hangs", {"": Normal(0.0, 1.0)}),
    "vibration": Prior(COMMON, "a blade that is nicked or loose", {"": Normal(0.0, 1.0)}),
    "sensor_noise_level": Prior(RARE, "a sensor that fails", {"": Normal(0.0, 1.0)}),
}
"""What may begin within a second in flight, as changes of numbers, whatever the weather."""
BESIDE = (
    "thrust_scale",
    "thrust_curve",
    "yaw_torque_scale",
    "inertia_error",
    "rotor_drag",
    "parasitic_drag",
    "imu_lever_arm",
    "accel_scale",
    "gyro_scale",
    "heading_offset",
)
"""By which a calibrated model may be a little off all the time; they do not begin in flight."""
SHOWN_BY_CHANGE = {"battery_sag": 0.1}
"""Effects that show only once something else has changed, such as the voltage: what a quiet start
does not tell counts as begun by then, and the standing model as good, to so much of the usual
share."""
ONLY_MORE = ("rotor_efficiency_loss", "mass_offset", "inertia_error", "slung_load")
"""What broke or was strapped on only adds."""


def prior_of(effect: Effect) -> Prior:
    """Of an effect; of one without a row, that it is rare and anywhere in its range."""
    if effect.name in PRIORS:
        return PRIORS[effect.name]
    numbers = {}
    for p in (*effect.parameters, *effect.of_logs):
        low, high = p.bounds
        middle = (low + high) / 2 if p.neutral is None else p.neutral
        numbers[p.name] = Normal(middle, (high - low) / 4)
    return Prior(RARE, "a quarter of the range: nothing else is known", numbers)
