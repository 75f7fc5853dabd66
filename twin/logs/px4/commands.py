"""Motor commands of a PX4 log: logged, or rebuilt at full rate."""

import numpy as np

from ..columns import MAX_MOTORS, MIN_MOTORS
from ..flight import Array
from ..outputs import MotorOutput, described
from .log import Px4Log
from .outputs import MotorCommands, Outputs, logged_outputs
from .rebuild import MATCH_GOAL_US, CannotRebuildError, rebuild

_ENOUGH_HZ = 100.0
_BACKWARD = 0.01
_ABSURD = 3.0  # a pulse width of 0 us, of motors that are off, is -1 or -2


def from_px4_commands(log: Px4Log, rebuild: bool | None) -> MotorCommands | None:
    """Motor commands of a log.

    Args:
        log: The log; findings are added to it.
        rebuild: As in `formats.ReadOptions`.
    """
    return _from_motors(log) or _from_outputs(log, rebuild)


def _from_motors(log: Px4Log) -> MotorCommands | None:
    """`actuator_motors` (PX4 1.13 and later): thrust of motor i in control[i - 1], made a command
    by the thrust curve of THR_MDL_FAC as the output drivers do.

    Source: PX4, lib/mixer_module/functions/FunctionMotors.hpp.
    """
    topic = log.topic("actuator_motors", 0, "control[0]", "control[1]", "control[2]")
    if topic is None:
        return None
    fields = [f"control[{k}]" for k in range(MAX_MOTORS) if topic.has(f"control[{k}]")]
    control = topic.columns(fields)
    used = [k for k in range(len(fields)) if np.nanmax(np.abs(control[:, k]), initial=0.0) > 0.0]
    if len(used) < MIN_MOTORS:
        log.note("warning", "cmd", f"actuator_motors has values for {len(used)} motors: not used")
        return None
    count = int(log.params.get("CA_ROTOR_COUNT", 0.0))
    if not MIN_MOTORS <= count <= len(fields):
        count = used[-1] + 1
    if idle := [str(k + 1) for k in range(count) if k not in used]:
        log.note("warning", "cmd", f"no value for motor {', '.join(idle)} of {count}: taken as 0")
    control = control[:, :count]
    stopped = np.isnan(control)
    alone = int(stopped[~stopped.all(axis=1)].sum())
    if alone:
        text = "values NaN in actuator_motors, while others have some, mean stopped: taken as 0"
        log.note("warning", "cmd", text, alone)
    if together := int(stopped.sum()) - alone:
        log.note("info", "cmd", "values NaN in actuator_motors mean stopped, taken as 0", together)
    control = np.where(stopped, 0.0, control)
    backward = int(np.count_nonzero(control < -_BACKWARD))
    if backward and topic.has("reversible_flags") and topic.data["reversible_flags"].any():
        text = (
            "values of motors that turn backward (reversible_flags), which is not known: set to 0"
        )
        log.note("error", "cmd", text, backward)
    cmd = _clipped(log, _through_curve(log, control), "actuator_motors")
    outputs = [
        MotorOutput(k + 1, f"actuator_motors control[{k}]", "", 0.0, 1.0, "number of the field")
        for k in range(count)
    ]
    rate = f"actuator_motors, {topic.rate_hz:.0f} Hz"
    return MotorCommands(topic.t_us, cmd, {"commands": rate, "motors": described(outputs)})


def _through_curve(log: Px4Log, thrust: Array) -> Array:
    """Command of a thrust: thrust = f u^2 + (1 - f) u with f = THR_MDL_FAC."""
    factor = log.params.get("THR_MDL_FAC", 0.0)
    if not 0.0 < factor <= 1.0:
        return thrust
    log.note(
        "info",
        "cmd",
        f"actuator_motors is thrust; made a command by THR_MDL_FAC {factor:.3g}, as its drivers do",
    )
    half = (1.0 - factor) / (2.0 * factor)
    return np.asarray(np.sqrt(half**2 + np.maximum(thrust, 0.0) / factor) - half)


def _from_outputs(log: Px4Log, rebuild: bool | None) -> MotorCommands | None:
    """`actuator_outputs`, scaled by the PWM range."""
    outputs = logged_outputs(log)
    if outputs is None:
        neither = "neither actuator_motors nor actuator_outputs"
        why = "" if log.instances("actuator_outputs") else f": {neither}"
        log.note("warning", "cmd", f"no motor commands{why}")
        return None
    rate, facts = outputs.topic.rate_hz, dict[str, str]()
    if rebuild or (rebuild is None and rate < _ENOUGH_HZ):
        try:
            return _rebuilt(log, outputs, asked=bool(rebuild))
        except CannotRebuildError as why:
            log.note("warning", "cmd", f"not rebuilt at full rate: {why}")
            facts["commands_not_rebuilt"] = str(why)
    if rate < _ENOUGH_HZ:
        log.note(
            "warning", "cmd", f"motor commands at only {rate:.0f} Hz; each is held until the next"
        )
    cmd = _clipped(log, outputs.cmd, "actuator_outputs")
    facts["commands"] = f"actuator_outputs, {rate:.0f} Hz"
    facts["motors"] = described(outputs.motors)
    return MotorCommands(outputs.topic.t_us, cmd, facts)


def _rebuilt(log: Px4Log, outputs: Outputs, asked: bool) -> MotorCommands:
    """Commands rebuilt at full rate.

    Raises:
        CannotRebuildError: The log lacks something, or they are not those that were flown and
            nobody asked for them.
    """
    commands, match = rebuild(log, outputs)
    worst = float(np.max(match.rms_us))
    each = ", ".join(f"{r:.1f}" for r in match.rms_us)
    told = f"rms {each} us of pulse width per motor, n = {match.n} logged outputs while flying"
    if match.n == 0:
        log.note("warning", "cmd", "rebuilt commands have no logged output in flight to check them")
    elif match.misses and not asked:
        raise CannotRebuildError(
            f"{match.misses}, so this is not the controller that flew, or not with its parameters "
            f"({told}); --rebuild-commands takes them all the same"
        )
    elif worst > MATCH_GOAL_US:
        log.note("warning", "cmd", f"rebuilt commands miss the logged ones by over 10 us: {told}")
    log.note(
        "info",
        "cmd",
        "rebuilt by running the rate controller again on gyro and setpoints; its integral starts "
        "from the logged one at every rate_ctrl_status; logged outputs only check the result",
    )
    rate = (len(commands.t_us) - 1) / ((commands.t_us[-1] - commands.t_us[0]) * 1e-6)
    facts = {
        "commands": f"rebuilt from gyro and rate setpoints, {rate:.0f} Hz",
        "commands_match": told,
        "motors": described(outputs.motors),
    }
    return MotorCommands(commands.t_us, commands.cmd, facts)


def _clipped(log: Px4Log, cmd: Array, where: str) -> Array:
    """Commands within 0..1, counting what lay outside."""
    absurd = int(np.count_nonzero(np.abs(cmd) > _ABSURD))
    if absurd:
        log.note("error", "cmd", f"values of {where} beyond {_ABSURD:g} set to 0 or 1", absurd)
    outside = int(np.count_nonzero((cmd < -1e-6) | (cmd > 1.0 + 1e-6))) - absurd
    if outside:
        log.note(
            "info",
            "cmd",
            f"values of {where} outside 0..1 (disarmed, or arming) set to its end",
            outside,
        )
    return np.asarray(np.clip(cmd, 0.0, 1.0))
