"""What parameters of ArduPilot say of motors, filters and limits, by the names of Copter or, with
`Q_` before them, of Plane's quadplanes."""

from collections.abc import Mapping

from .file.history import NAMES

MOTOR_FUNCTIONS = {**{33 + k: k + 1 for k in range(8)}, **{82 + k: k + 9 for k in range(4)}}
"""SERVOn_FUNCTION of an output that drives a motor: the number of the motor."""
_OUTPUTS = 32
TRICOPTER = (1, 2, 4)
"""Its motors by number."""
_DIGITAL = range(4, 9)
"""MOT_PWM_TYPE of DShot, whose outputs are logged as 1000 to 2000."""
_DIGITAL_US = (1000.0, 2000.0)


def motor_value(params: Mapping[str, float], name: str, default: float) -> float:
    """A parameter of the motors, such as `MOT_SPIN_MIN`, or its default."""
    quadplane = f"Q_{name.replace('MOT_', 'M_', 1)}"
    there = [n for n in (name, quadplane, NAMES.get(name, "")) if n in params]
    return params[there[0]] if there else default


def motor_channels(params: Mapping[str, float]) -> list[int]:
    """Output, from 1, of motor 1, 2, ... as SERVOn_FUNCTION tells; [] where that leaves a hole.

    A tricopter has motors 1, 2 and 4.
    """
    outputs = {}
    for n in range(_OUTPUTS, 0, -1):  # of two outputs for one motor the first counts
        function = int(params.get(f"SERVO{n}_FUNCTION", 0.0))
        if function in MOTOR_FUNCTIONS:
            outputs[MOTOR_FUNCTIONS[function]] = n
    motors = sorted(outputs)
    if motors[:3] == list(TRICOPTER) and 3 not in motors:
        motors = list(TRICOPTER)  # the seventh tilts the tail
    elif motors != list(range(1, len(motors) + 1)):
        return []
    return [outputs[m] for m in motors]


def pulse_range_us(params: Mapping[str, float]) -> tuple[float, float]:
    """Pulse widths of command 0 and 1, us: of MOT_PWM_MIN and _MAX, else of the throttle stick."""
    if int(motor_value(params, "MOT_PWM_TYPE", 0.0)) in _DIGITAL:
        return _DIGITAL_US
    low, high = (motor_value(params, f"MOT_PWM_{k}", 0.0) for k in ("MIN", "MAX"))
    if 0.0 < low < high:
        return low, high
    stick = int(params.get("RCMAP_THROTTLE", 3.0))
    low, high = (params.get(f"RC{stick}_{k}", 0.0) for k in ("MIN", "MAX"))
    return (low, high) if 0.0 < low < high else _DIGITAL_US
