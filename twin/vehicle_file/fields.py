"""Every key of a vehicle file: the one definition for the reader and `docs/reference`."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Field:
    """One key of a vehicle file.

    Attributes:
        unit: SI unit of the converted value; "" for text; "poly:U" for a polynomial whose value has
            unit U.
        shape: Shape of the value: "scalar", "vector", "inertia", "n x 3", "list", "pair", "lag",
            "rates", "table" or "polynomial".
        required: Whether the key is mandatory.
        positive: Whether every number must be > 0; `None` when any sign is allowed, `False` for >=
            0.
        meaning: Meaning, one line for the documentation.
    """

    unit: str
    shape: str
    required: bool
    positive: bool | None
    meaning: str


FIELDS: dict[str, Field] = {
    "body.mass": Field("kg", "scalar", True, True, "Take-off mass, battery included."),
    "body.inertia": Field(
        "kg*m^2",
        "inertia",
        True,
        None,
        "Inertia about the centre of mass, body FRD: [Ixx, Iyy, Izz] or "
        "[Ixx, Iyy, Izz, Ixy, Ixz, Iyz] with the elements of the matrix (not the products "
        "with opposite sign).",
    ),
    "body.drag_linear": Field(
        "N*s/m",
        "vector",
        False,
        False,
        "Linear drag [x, y, z] in body axes: force = -drag * air-relative velocity. Given in "
        "1/s it is multiplied by the mass.",
    ),
    "body.drag_quadratic": Field(
        "N*s^2/m^2",
        "vector",
        False,
        False,
        "Quadratic drag [x, y, z] in body axes, 0.5 rho Cd A: force = -drag |v_i| v_i.",
    ),
    "body.drag_parasitic": Field(
        "N*s^2/m^2",
        "vector",
        False,
        False,
        "Quadratic drag [x, y, z] in body axes by the whole speed: force = -drag |v| v_i.",
    ),
    "body.drag_angular": Field(
        "N*m*s^2/rad^2",
        "vector",
        False,
        False,
        "Damping [x, y, z] by the square of the body rates: moment = -drag |omega_i| omega_i.",
    ),
    "body.leg_height": Field(
        "m",
        "scalar",
        False,
        False,
        "Height of the centre of mass over the ground when standing; feet are below the "
        "rotors. Without it: half the largest rotor arm.",
    ),
    "rotors.position": Field(
        "m",
        "n x 3",
        True,
        None,
        "Rotor hubs [x forward, y right, z down] from the centre of mass, one row per motor, "
        "in the order of the motor commands cmd_1, cmd_2, ...",
    ),
    "rotors.direction": Field(
        "", "list", True, None, 'Sense of rotation seen from above, "cw" or "ccw", per rotor.'
    ),
    "rotors.thrust_from_speed": Field(
        "poly:N",
        "polynomial",
        False,
        None,
        "Thrust of one rotor against its speed. A single value k means k * speed^2.",
    ),
    "rotors.thrust_from_command": Field(
        "poly:N",
        "polynomial",
        False,
        None,
        "Thrust of one rotor against its command; where it is negative it counts as zero.",
    ),
    "rotors.speed_from_command": Field(
        "poly:rad/s", "polynomial", False, None, "Steady rotor speed against its command."
    ),
    "rotors.torque_per_thrust": Field(
        "m", "scalar", False, False, "Reaction torque over thrust of one rotor."
    ),
    "rotors.torque_from_speed": Field(
        "poly:N*m",
        "polynomial",
        False,
        None,
        "Reaction torque of one rotor against its speed. A single value k means k * speed^2.",
    ),
    "rotors.torque_from_command": Field(
        "poly:N*m", "polynomial", False, None, "Reaction torque of one rotor against its command."
    ),
    "rotors.command_range": Field(
        "",
        "pair",
        False,
        None,
        "Raw command at cmd = 0 and at cmd = 1 (e.g. [1100, 1950] us, [0, 65535]); every "
        "polynomial of the command is in raw commands. Without it: [0, 1].",
    ),
    "rotors.lag": Field(
        "s",
        "lag",
        False,
        True,
        "Time constant of the first-order lag from command to rotor speed (to effective "
        "command when thrust comes from the command): one value, or [up, down].",
    ),
    "rotors.rate_up": Field(
        "1/s",
        "rates",
        False,
        False,
        "In place of lag, coefficients [a, b]: a rotor speeds up with a (u - w) + b (u^2 - w^2), "
        "w its speed and u that of its command.",
    ),
    "rotors.rate_down": Field(
        "1/s", "rates", False, False, "The same for a rotor that slows down; given with rate_up."
    ),
    "rotors.spin_inertia": Field(
        "kg*m^2",
        "scalar",
        False,
        False,
        "Inertia of one rotor with its bell about its axis: gyroscopic torque. Needs the speed.",
    ),
    "rotors.reaction_inertia": Field(
        "kg*m^2",
        "scalar",
        False,
        False,
        "Inertia of one rotor in the reaction to its own acceleration: yaw torque -J dw/dt. Needs "
        "the speed. Default 0: no reaction.",
    ),
    "rotors.diameter": Field(
        "m", "scalar", False, True, "Diameter of a rotor; with the two tables that follow."
    ),
    "rotors.thrust_by_advance": Field(
        "1",
        "table",
        False,
        None,
        "Rows [J, thrust over that at rest], J = climb speed of the hub / (turns per second * "
        "diameter); straight lines between them, the end values beyond. Needs speed and diameter.",
    ),
    "rotors.torque_by_advance": Field(
        "1", "table", False, None, "Rows [J, reaction torque over that at rest], likewise."
    ),
    "rotors.drag": Field(
        "kg/rad",
        "scalar",
        False,
        False,
        "Drag of one rotor in its plane, at its hub: force = -drag w [V_x, V_y, 0], V the velocity "
        "of the hub through the air. Needs the speed w.",
    ),
    "rotors.inflow": Field(
        "kg/rad",
        "scalar",
        False,
        False,
        "Thrust that one rotor loses in a climb: thrust += inflow w V_z. Needs the speed w.",
    ),
    "rotors.lift": Field(
        "N*s^2/m^2",
        "scalar",
        False,
        None,
        "Thrust that one rotor gains in forward flight: thrust += lift (V_x^2 + V_y^2).",
    ),
    "rotors.flapping_moment": Field(
        "kg*m/rad",
        "scalar",
        False,
        None,
        "Moment of one rotor whose disc flaps back: moment = flapping_moment w [-V_y, V_x, 0], "
        "nose up in forward flight where positive. Needs the speed w.",
    ),
    "rotors.rolling_moment": Field(
        "kg*m/rad",
        "scalar",
        False,
        None,
        "Moment of one rotor against its velocity: moment = -rolling_moment w [V_x, V_y, 0], "
        "whatever its sense of rotation. Needs the speed w.",
    ),
    "rotors.reference_voltage": Field(
        "V",
        "scalar",
        False,
        True,
        "Battery voltage at which the maps of the command hold. Without it voltage is ignored.",
    ),
    "rotors.voltage_exponent": Field(
        "1",
        "scalar",
        False,
        None,
        "The command is multiplied by (voltage / reference)^exponent before the maps. Default 1.",
    ),
    "imu.position": Field(
        "m", "vector", False, None, "Accelerometer [x, y, z] from the centre of mass, body FRD."
    ),
    "imu.accel_cutoff": Field(
        "Hz", "scalar", False, True, "Second-order low-pass of the accelerometer; absent: none."
    ),
    "imu.gyro_cutoff": Field(
        "Hz", "scalar", False, True, "Second-order low-pass of the gyroscope; absent: none."
    ),
    "imu.accel_noise": Field(
        "m/s^2", "scalar", False, False, "White noise of a reading, standard deviation. Default 0."
    ),
    "imu.accel_walk": Field(
        "m/s^2",
        "scalar",
        False,
        False,
        "Random walk of the accelerometer's bias, standard deviation after 1 s. Default 0.",
    ),
    "imu.gyro_noise": Field(
        "rad/s", "scalar", False, False, "White noise of a reading, standard deviation. Default 0."
    ),
    "imu.gyro_walk": Field(
        "rad/s",
        "scalar",
        False,
        False,
        "Random walk of the gyroscope's bias, standard deviation after 1 s. Default 0.",
    ),
    "battery.full_voltage": Field("V", "scalar", False, True, "Open-circuit voltage when full."),
    "battery.empty_voltage": Field("V", "scalar", False, True, "Open-circuit voltage when empty."),
    "battery.capacity": Field("A*s", "scalar", False, True, "Charge from full to empty."),
    "battery.resistance": Field("ohm", "scalar", False, False, "Internal resistance."),
    "battery.hover_current": Field("A", "scalar", False, True, "Current drawn in hover."),
    "magnetometer.field": Field(
        "T",
        "vector",
        False,
        None,
        "Magnetic flux density at the site [north, east, down]. Without it: by the World Magnetic "
        "Model from [site]; without that either, that of southern Germany.",
    ),
    "magnetometer.noise": Field(
        "T", "scalar", False, False, "White noise of a reading, standard deviation. Default 0."
    ),
    "magnetometer.walk": Field(
        "T",
        "scalar",
        False,
        False,
        "Random walk of the bias, standard deviation after 1 s. Default 0.",
    ),
    "barometer.noise": Field(
        "Pa", "scalar", False, False, "White noise of a reading, standard deviation. Default 0."
    ),
    "barometer.walk": Field(
        "Pa",
        "scalar",
        False,
        False,
        "Random walk of the bias, standard deviation after 1 s. Default 0.",
    ),
    "position.period": Field("s", "scalar", False, True, "Time between two samples."),
    "position.delay": Field("s", "scalar", False, False, "From the motion to the output."),
    "position.antenna": Field(
        "m",
        "vector",
        False,
        None,
        "Antenna or markers [x, y, z] from the centre of mass, body FRD.",
    ),
    "position.noise": Field(
        "m",
        "vector",
        False,
        False,
        "White noise of the position [north, east, down], standard deviation.",
    ),
    "position.walk": Field(
        "m",
        "vector",
        False,
        False,
        "Random walk of the position error [north, east, down], standard deviation after 1 s.",
    ),
    "position.velocity_noise": Field(
        "m/s",
        "vector",
        False,
        False,
        "White noise of the velocity [north, east, down], standard deviation.",
    ),
    "position.attitude_noise": Field(
        "rad",
        "scalar",
        False,
        False,
        "White noise of the attitude about each axis, standard deviation; motion capture alone.",
    ),
    "site.latitude": Field(
        "rad", "scalar", False, None, "Geodetic latitude of the site, north > 0."
    ),
    "site.longitude": Field("rad", "scalar", False, None, "Longitude of the site, east > 0."),
    "site.height": Field("m", "scalar", False, None, "Height over WGS 84. Default 0."),
    "site.gravity": Field(
        "m/s^2", "scalar", False, True, "Acceleration of free fall. Default 9.80665 m/s^2."
    ),
    "site.year": Field("1", "scalar", False, None, "Decimal year of the flights. Default 2025.5."),
    "site.pressure": Field(
        "Pa", "scalar", False, True, "Static pressure at the origin of NED. Default 101325 Pa."
    ),
    "site.temperature": Field(
        "K", "scalar", False, True, "Air temperature at the origin of NED. Default 288.15 K."
    ),
}
"""Every key of a vehicle file, in the order of the documentation."""
