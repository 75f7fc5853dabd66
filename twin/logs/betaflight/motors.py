"""Motor outputs and rotor speeds of a Blackbox log, and what they tell of the mixer.

Motors of Betaflight's QUADX: 1 rear right, 2 front right, 3 rear left, 4 front left; 1 and 4 turn
clockwise unless yaw_motors_reversed. Source: mixer.c and motor.h of Betaflight, and its manual.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...vehicle.layouts import Layout, frame
from ..assemble import Rows
from ..columns import MAX_MOTORS, MIN_MOTORS, motor_columns
from ..flight import Array
from .log import BlackboxLog
from .signals import add

_DIGITAL = (5, 6, 7, 8)
"""DSHOT150, 300, 600 and PROSHOT1000 in motor_pwm_protocol."""
_DSHOT_STOP, _DSHOT_FULL = 48.0, 2047.0
_PULSE_STOP, _PULSE_FULL = 1000.0, 2000.0
_FEATURE_3D = 1 << 12
_PER_ERPM = 100.0 * 2.0 * np.pi / 60.0
_TURNING = 0.05
_MOST_SILENT = 0.2
_SURE = 0.5
_QUAD = {
    "roll": np.array((-1.0, -1.0, 1.0, 1.0)),
    "pitch": np.array((1.0, -1.0, 1.0, -1.0)),
    "yaw": np.array((1.0, -1.0, -1.0, 1.0)),
}
"""What QUADX adds to each motor for a positive output of a controller."""
_SEEN = "QUADX, as the motors follow the controllers"
_DOUBT = "four motors, taken for QUADX"


@dataclass(frozen=True, slots=True)
class Motors:
    """The outputs.

    Attributes:
        count: Number of them.
        commands: 0..1, shape (n, count); None: left out.
        pulse_us: Pulse widths that stand for 0 and 1; None: digital.
    """

    count: int
    commands: Array | None
    pulse_us: tuple[float, float] | None


def add_motors(log: BlackboxLog, rows: Rows) -> Motors:
    """Commands and rotor speeds into the table."""
    main = log.recording.main
    count = next((k for k in range(MAX_MOTORS) if f"motor[{k}]" not in main.names), MAX_MOTORS)
    if count < MIN_MOTORS:
        message = f"{count} motor outputs in the log, a multirotor has {MIN_MOTORS} at least"
        log.note("warning", "cmd", f"{message}; enable the field MOTOR of Blackbox")
        return Motors(count, None, None)
    raw = main.columns([f"motor[{k}]" for k in range(count)])
    if log.header.whole("features", 0) & _FEATURE_3D:
        log.note("error", "cmd", "left out: motors that turn both ways (feature 3D) are not known")
        return Motors(count, None, None)
    low, high, digital = _range(log)
    if not high > low:
        log.note("error", "cmd", f"left out, the head has motors from {low:g} to {high:g}")
        return Motors(count, None, None)
    commands = np.clip((raw - low) / (high - low), 0.0, None)
    add(log, rows, "cmd", motor_columns("cmd", count), main.t_us, commands)
    _add_speeds(log, rows, commands)
    return Motors(count, commands, None if digital else (low, high))


def _range(log: BlackboxLog) -> tuple[float, float, bool]:
    """Outputs for a motor that stands and for full power, and whether they are digital."""
    header = log.header
    outputs = header.numbers("motorOutput")
    protocol = header.whole("motor_pwm_protocol", -1)
    digital = protocol in _DIGITAL if protocol >= 0 else len(outputs) > 1 and outputs[0] < 1000.0
    if digital:
        return _DSHOT_STOP, _DSHOT_FULL, True
    low = header.number("mincommand", _PULSE_STOP)
    return low, header.number("maxthrottle", _PULSE_FULL), False


def _add_speeds(log: BlackboxLog, rows: Rows, commands: Array) -> None:
    """Rotor speeds of bidirectional DSHOT: hundreds of electrical revolutions per minute."""
    main, count = log.recording.main, commands.shape[1]
    fields = next(
        (
            f
            for stem in ("eRPM", "eRPM(/100)")
            if main.has(*(f := tuple(f"{stem}[{k}]" for k in range(count))))
        ),
        (),
    )
    if not fields:
        return
    poles = log.header.number("motor_poles", 0.0)
    if not poles >= 2.0:
        told = log.header.settings.get("motor_poles", "")[:20]
        log.note("error", "rotor", f"left out, the head says motor_poles {told!r}")
        return
    raw = main.columns(fields)
    silent = ((raw <= 0.0) & (commands > _TURNING)).any(axis=1)
    if silent.mean() > _MOST_SILENT:
        share = 100.0 * silent.mean()
        message = f"left out, a motor that is told to turn reports no speed in {share:.0f} %"
        log.note("warning", "rotor", f"{message} of the frames")
        return
    if silent.any():
        message = "frames left out, a motor that is told to turn reports no speed"
        log.note("warning", "rotor", message, int(silent.sum()))
    speeds = raw[~silent] * (_PER_ERPM / (poles / 2.0))
    add(log, rows, "rotor", motor_columns("rotor", count), main.t_us[~silent], speeds)


def mixed(log: BlackboxLog, motors: Motors) -> dict[str, float]:
    """Correlation of what each controller puts out with what QUADX makes of it, by axis; {} where
    the log has not got both."""
    main = log.recording.main
    if motors.count != 4 or motors.commands is None:
        return {}
    found = {}
    for k, (axis, pattern) in enumerate(_QUAD.items()):
        parts = [f"axis{p}[{k}]" for p in "PIDFS" if f"axis{p}[{k}]" in main.names]
        if not parts:
            continue
        asked = main.columns(parts).sum(axis=1)
        given = motors.commands @ pattern
        if asked.std() > 0.0 and given.std() > 0.0:
            found[axis] = float(np.corrcoef(asked, given)[0, 1])
    return found


def layout_of(log: BlackboxLog, motors: Motors) -> tuple[Layout | None, dict[str, str]]:
    """Where the motors are and how they turn, and facts; None where that is not known."""
    if motors.count != 4:
        return None, {}
    seen = mixed(log, motors)
    facts = {}
    if seen:
        told = ", ".join(f"{axis} {r:+.2f}" for axis, r in seen.items())
        facts["mixer"] = f"QUADX; controllers against motors by axis: {told}"
    wrong = [axis for axis in ("roll", "pitch") if seen.get(axis, 1.0) < -_SURE]
    if wrong:
        message = f"motors do not follow the controllers as in QUADX ({', '.join(wrong)})"
        log.note("warning", "cmd", f"{message}: another mixer, or motors remapped")
        return None, facts
    sure = min(seen.get(axis, 0.0) for axis in ("roll", "pitch")) > _SURE
    layout = frame("betaflight x", _SEEN if sure else _DOUBT)
    if not sure:
        log.note("info", "cmd", f"the log does not tell the mixer: {_DOUBT}")
        layout = replace(layout, places_known=False)
    yaw = seen.get("yaw", 0.0)
    if abs(yaw) < _SURE:
        message = "the log does not tell yaw_motors_reversed: motors 1 and 4 taken for clockwise"
        log.note("info", "cmd", message)
        return replace(layout, senses_known=False), facts
    if yaw < 0.0:
        facts["propellers"] = "reversed, as the motors follow the yaw controller"
        turned: NDArray[np.float64] = -layout.direction
        source = layout.source.replace("not reversed", "reversed")
        return replace(layout, direction=turned, source=source), facts
    facts["propellers"] = "not reversed, as the motors follow the yaw controller"
    return layout, facts
