"""PX4 ULog -> Flight. All conversions from PX4's units and names are in this package."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..assemble import FlightBuilder
from ..autopilot import (
    Autopilot,
    Filter,
    FilterKind,
    Interval,
    Reset,
    ResetOf,
    Sensor,
    Setpoint,
    Span,
    differing,
    ground_spans,
    modes_of,
    motion_spans,
    setpoint_of,
    stretches_of,
)
from ..columns import GYRO, POS, QUAT, VEL
from ..flight import Array, Flight
from ..formats import ReadOptions
from ..motors import MotorCommands, doubt_current
from .airframe import FILTERS, from_px4_airframe, from_px4_site
from .imu import add_barometer, add_imu, add_magnetometer
from .log import Px4Log, Topic, open_px4
from .outputs import add_rotors
from .rebuild import from_px4_commands

# -- phases -------------------------------------------------------------------------------------
#
# Phases of a PX4 log: by the markers of the test script, else by the motion of the vehicle.

_MARKER = 183  # vehicle_command.command of RflySim's scripts
_BEGIN, _END = 666, 777  # param7 of a marker
_MODES = {(2, 3): "takeoff", (2, 6): "hover", (2, 7): "land"}  # param1 and param2 of a marker
_NOT_A_PHASE = {(2, 1)}  # preparation of the offboard mode before takeoff
_SEAM_S = 0.1  # gap between two successive phases


def from_px4_phases(log: Px4Log) -> list[Span]:
    """Phases of a PX4 log: markers of the test script, else landed state, speed and climb rate."""
    ground = _ground(log)
    marked = _marked(log)
    if marked:
        log.note("info", "phase", "from the markers (vehicle_command 183) of the test script")
        start, end = marked[0][1], marked[-1][2]
        before = [(n, a, min(b, start)) for n, a, b in ground if a < start]
        after = [(n, max(a, end), b) for n, a, b in ground if b > end]
        return [*before, *marked, *after]
    moved = _from_motion(log, ground)
    if moved:
        log.note("info", "phase", "from landed state, speed and climb rate; no markers in the log")
    return moved


def _marked(log: Px4Log) -> list[Span]:
    """Spans between the begin and end markers of the RflySim test scripts."""
    topic = log.topic("vehicle_command", 0, "command", "param1", "param2", "param7")
    if topic is None:
        return []
    spans: list[Span] = []
    begun: dict[tuple[int, int], float] = {}
    for t, command, p1, p2, p7 in zip(
        topic.t_s,
        topic.data["command"],
        *(topic.data[f"param{k}"].tolist() for k in (1, 2, 7)),
        strict=True,
    ):
        if command != _MARKER or p7 not in (_BEGIN, _END):
            continue
        if not np.isfinite((p1, p2)).all():
            log.note("warning", "phase", f"marker at {t:.2f} s whose mode is {p1:g}, {p2:g}")
            continue
        mode = (int(p1), int(p2))
        if mode in _NOT_A_PHASE:
            continue
        if mode not in _MODES:
            log.note("warning", "phase", f"marker of an unknown mode {mode} at {t:.2f} s")
        elif p7 == _BEGIN:
            begun[mode] = float(t)
        elif mode in begun:
            spans.append((_MODES[mode], begun.pop(mode), float(t)))
    for mode, t in begun.items():
        log.note("warning", "phase", f"{_MODES[mode]} begins at {t:.2f} s and has no end marker")
        spans.append((_MODES[mode], t, np.inf))
    spans.sort(key=lambda s: s[1])
    for k, (name, start, end) in enumerate(spans[:-1]):
        follows = spans[k + 1][1]
        if 0.0 < follows - end < _SEAM_S:
            spans[k] = (name, start, follows)
    return spans


def _ground(log: Px4Log) -> list[Span]:
    """Spans on the ground, from the land detector."""
    topic = log.topic("vehicle_land_detected", 0, "landed")
    return [] if topic is None else ground_spans(topic.t_s, topic.data["landed"].astype(bool))


def _from_motion(log: Px4Log, ground: list[Span]) -> list[Span]:
    """Spans by the motion in the estimator's output."""
    topic = log.topic("vehicle_local_position", 0, "vx", "vy", "vz")
    if topic is None:
        return ground
    return motion_spans(topic.t_s, topic.columns(("vx", "vy", "vz")), ground)


# -- autopilot ----------------------------------------------------------------------------------
#
# PX4's records of a flight: modes, arming, failsafes, setpoints, filters.

MODES = {
    **{0: "Manual", 1: "Altitude", 2: "Position", 3: "Mission", 4: "Hold", 5: "Return"},
    **{6: "Position Slow", 10: "Acro", 12: "Descend", 13: "Termination", 14: "Offboard"},
    **{15: "Stabilized", 16: "Rattitude", 17: "Takeoff", 18: "Land", 19: "Follow Me"},
    **{20: "Precision Land", 21: "Orbit", 22: "VTOL Takeoff"},
    **{k: f"External {k - 22}" for k in range(23, 31)},
}
"""Flight modes by vehicle_status.nav_state, named as in QGroundControl.

Source: PX4, msg/vehicle_status.msg of 1.10 to 1.16.
"""
_RESET_COUNTERS: dict[str, dict[str, ResetOf]] = {
    "vehicle_attitude": {"quat_reset_counter": "attitude"},
    "vehicle_local_position": {
        "xy_reset_counter": "position",
        "z_reset_counter": "height",
        "vxy_reset_counter": "velocity",
        "vz_reset_counter": "velocity",
    },
}
"""Counters by topic and the kind of reset that they count, uint8. Source: PX4,
msg/VehicleAttitude.msg, msg/VehicleLocalPosition.msg."""
_MOST_RESETS = 8
"""Largest number of resets between two logged samples; a larger or negative step is a restart or a
damaged byte."""
_ARMED = 2
"""Value of vehicle_status.arming_state when armed, in every release."""
_UNIT_NORM = 0.01  # tolerance of a quaternion's norm from 1
_OF: dict[str, tuple[Sensor, FilterKind]] = {
    "gyroscope": ("gyro", "low-pass"),
    "accelerometer": ("acc", "low-pass"),
    "notch": ("gyro", "notch"),
}
"""Sensor and type of a filter in `FILTERS`."""


def from_px4_autopilot(log: Px4Log, end_s: float) -> Autopilot:
    """PX4's records of a flight; none of them is a finding.

    Args:
        log: The log.
        end_s: End of the record, s.
    """
    status = log.aside("vehicle_status", "nav_state")
    names = [] if status is None else [mode_name(int(k)) for k in status.data["nav_state"]]
    return Autopilot(
        modes_of(np.zeros(0) if status is None else status.t_s, names, end_s),
        _armed(log, end_s),
        _failsafes(log, end_s),
        log.messages,
        tuple(
            s
            for s in (
                _position_setpoint(log),
                _velocity_setpoint(log),
                _attitude_setpoint(log),
                _rates_setpoint(log),
            )
            if s
        ),
        differing(log.params, log.defaults),
        _filters(log.params),
        tuple(r for r in _resets(log) if 0.0 <= r.t_s <= end_s),
    )


def mode_name(nav_state: int) -> str:
    """Name of a flight mode."""
    return MODES.get(nav_state, f"nav_state {nav_state}")


def _armed(log: Px4Log, end_s: float) -> tuple[Interval, ...]:
    status = log.aside("vehicle_status", "arming_state")
    if status is not None:
        return stretches_of(status.t_s, status.data["arming_state"] == _ARMED, "armed", end_s)
    armed_topic = log.aside("actuator_armed", "armed")
    if armed_topic is None:
        return ()
    return stretches_of(armed_topic.t_s, armed_topic.data["armed"].astype(np.bool_), "armed", end_s)


def _failsafes(log: Px4Log, end_s: float) -> tuple[Interval, ...]:
    status = log.aside("vehicle_status", "failsafe")
    if status is None:
        return ()
    return stretches_of(status.t_s, status.data["failsafe"].astype(np.bool_), "failsafe", end_s)


def _position_setpoint(log: Px4Log) -> Setpoint | None:
    return _setpoint(log, "vehicle_local_position_setpoint", POS, ("x", "y", "z"))


def _velocity_setpoint(log: Px4Log) -> Setpoint | None:
    """Velocity demanded by mission or pilot; without it that with the output of the position
    controller."""
    course, local = "trajectory_setpoint", ("vx", "vy", "vz")
    return (
        _setpoint(log, course, VEL, ("velocity[0]", "velocity[1]", "velocity[2]"))
        or _setpoint(log, course, VEL, local)
        or _setpoint(log, "vehicle_local_position_setpoint", VEL, local)
    )


def _rates_setpoint(log: Px4Log) -> Setpoint | None:
    return _setpoint(log, "vehicle_rates_setpoint", GYRO, ("roll", "pitch", "yaw"))


def _setpoint(
    log: Px4Log, name: str, columns: tuple[str, ...], fields: tuple[str, ...]
) -> Setpoint | None:
    """A setpoint in NED or FRD, SI, the frames and units of PX4."""
    topic = log.aside(name, *fields)
    return None if topic is None else setpoint_of(columns, topic.t_s, topic.columns(fields))


def _attitude_setpoint(log: Px4Log) -> Setpoint | None:
    """Quaternion FRD to NED, Hamilton, scalar first; None without it (before 1.6)."""
    fields = tuple(f"q_d[{k}]" for k in range(4))
    topic = log.aside("vehicle_attitude_setpoint", *fields)
    return None if topic is None else setpoint_of(QUAT, topic.t_s, _unit(topic.columns(fields)))


def _unit(q: Array) -> Array:
    """Quaternions unchanged; NaN where they are invalid."""
    with np.errstate(invalid="ignore", over="ignore"):
        off = ~(np.abs(np.linalg.norm(q, axis=1) - 1.0) < _UNIT_NORM)
    return np.where(off[:, None], np.nan, q)


def _filters(params: dict[str, float]) -> tuple[Filter, ...]:
    """Low-passes and notches of gyroscope and accelerometer whose frequency is set."""
    found = [
        Filter(*_OF[what], params[name], name)
        for name, what in FILTERS.items()
        if params.get(name, 0.0) > 0.0 and what in _OF
    ]
    return tuple(sorted(found, key=lambda f: f.frequency_hz))


# -- the flight ---------------------------------------------------------------------------------

_LEAST_V = 1.0  # voltage of a connected battery
_CELL_V = (2.5, 4.6)  # lowest voltage when discharged, and the highest of any lithium cell
_SAGS_V = 0.02  # a regulated supply varies less


def read_ulog(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a PX4 ULog; arguments and errors as in `formats.Reader`."""
    log = open_px4(path, blob)
    flight = FlightBuilder(log, path, _facts(log))
    filtered = add_imu(log, flight)
    add_magnetometer(log, flight)
    add_barometer(log, flight)
    _estimate(log, flight)
    commands = from_px4_commands(log, options.rebuild_commands)
    _end(log)
    _battery(log, flight, commands)
    add_rotors(log, flight, None if commands is None else commands.cmd.shape[1])
    flight.add_commands(commands)
    advice = "Log the default topics (SDLOG_PROFILE bit 0) and fly again."
    table = flight.lay_out(advice, ": was the clock set in flight?")
    return flight.flight(
        table,
        from_px4_phases(log),
        airframe=from_px4_airframe(log, filtered=filtered),
        autopilot=from_px4_autopilot(log, float(table["time"].iloc[-1])),
        site=from_px4_site(log),
    )


def _facts(log: Px4Log) -> dict[str, str]:
    """Facts of the log about the vehicle."""
    release = log.release
    version = ".".join(str(release >> shift & 0xFF) for shift in (24, 16, 8))
    facts = {"firmware": f"PX4 {version}" if release else "PX4"}
    if "ver_hw" in log.info:
        facts["hardware"] = log.info["ver_hw"]
    if "sys_uuid" in log.info:
        facts["aircraft"] = f"autopilot {log.info['sys_uuid']}"
    if "SYS_AUTOSTART" in log.params:
        facts["airframe"] = f"SYS_AUTOSTART {log.params['SYS_AUTOSTART']:.0f}"
    facts["clock"] = f"t = 0 is {log.start_us * 1e-6:.6f} s after boot, the start of the log"
    return facts


def _end(log: Px4Log) -> None:
    """Finding where the record stops before the flight does."""
    topic = log.topic("actuator_armed", 0, "armed")
    if topic is not None and topic.data["armed"][-1]:
        log.note(
            "error", "log", f"it ends at {topic.t_s[-1]:.1f} s with the motors armed: cut short?"
        )


def _estimate(log: Px4Log, flight: FlightBuilder) -> None:
    """Add position, velocity and attitude as estimated on board."""
    topic = log.topic("vehicle_local_position", 0, "x", "y", "z", "vx", "vy", "vz")
    if topic is None:
        log.note("warning", "pos", "no vehicle_local_position in the log: no position, no velocity")
    else:
        _position(log, flight, topic)
    topic = log.topic("vehicle_attitude", 0, *(f"q[{k}]" for k in range(4)))
    if topic is None:
        log.note("warning", "q", "no vehicle_attitude in the log: no attitude")
        return
    flight.add_attitude(topic.t_us, topic.array("q", 4))


def _position(log: Px4Log, flight: FlightBuilder, topic: Topic) -> None:
    """Add estimated position and velocity, without those that the estimator marks as invalid."""
    for where, names, fields, flags in (
        ("pos", POS, ("x", "y", "z"), ("xy_valid", "z_valid")),
        ("vel", VEL, ("vx", "vy", "vz"), ("v_xy_valid", "v_z_valid")),
    ):
        values = topic.columns(fields)
        valid = np.ones(len(values), dtype=np.bool_)
        for flag in flags:
            if topic.has(flag):
                valid &= topic.data[flag].astype(bool)
        log.note("info", where, "samples left out, the estimator says they are invalid", ~valid)
        flight.add(where, names, topic.t_us[valid], values[valid])
    vision = int(log.params.get("EKF2_AID_MASK", 0)) & 8 or int(log.params.get("EKF2_EV_CTRL", 0))
    delay = log.params.get("EKF2_EV_DELAY" if vision else "EKF2_GPS_DELAY")
    source = "external vision" if vision else "GPS"
    assumed = f"; it assumes {source} to be {delay:.0f} ms late" if delay is not None else ""
    log.note(
        "info",
        "pos",
        f"position and velocity are the estimator's, not a reference{assumed}. If the true delay "
        "differs, they lead or lag the truth by the difference",
    )


def _resets(log: Px4Log) -> Iterator[Reset]:
    """Steps that the estimator made in its own output, by its counters."""
    for name, counters in _RESET_COUNTERS.items():
        topic = log.aside(name)
        for counter, of in counters.items() if topic is not None else ():
            if topic is not None and topic.has(counter):
                forward = np.mod(np.diff(topic.data[counter].astype(np.int64)), 256)
                stepped = np.flatnonzero((forward > 0) & (forward <= _MOST_RESETS)) + 1
                yield from (Reset(of, float(t)) for t in topic.t_s[stepped])


def _battery(log: Px4Log, flight: FlightBuilder, commands: MotorCommands | None) -> None:
    """Add the voltage of the battery that drives the motors and, with a sensor, its current."""
    topic, said = _battery_in_use(log)
    if topic is None:
        return
    if said:
        flight.facts["battery"] = said
    volts = _volts(topic)
    if volts.any():
        flight.add("vbat_v", ("vbat_v",), topic.t_us, volts[:, None])
    if not topic.has("current_a"):
        return
    current = topic.columns(("current_a",))
    if reason := doubt_current(topic.t_us, current[:, 0], commands, "battery_status"):
        log.note("warning", "ibat_a", f"left out: {reason}", len(current))
    else:
        flight.add("ibat_a", ("ibat_a",), topic.t_us, current)


def _battery_in_use(log: Px4Log) -> tuple[Topic | None, str]:
    """The battery that is connected and has a voltage, of several the one whose voltage fits its
    cells and sags; and the criterion, "" where there is one."""
    instances = log.instances("battery_status")
    topics = [(k, t) for k in instances if (t := log.topic("battery_status", k)) is not None]
    live = [(k, t) for k, t in topics if np.nanmax(_volts(t), initial=0.0) >= _LEAST_V]
    if topics and not live:
        log.note("warning", "vbat_v", f"left out: battery_status never exceeds {_LEAST_V:g} V")
    if not live:
        return (topics[0][1] if topics else None), ""
    instance, topic = max(live, key=lambda each: (*_battery_rank(log, each[1]), -each[0]))
    if len(instances) == 1:
        return topic, ""
    rank = _battery_rank(log, topic)
    others = [k for k, t in live if t is not topic and _battery_rank(log, t) == rank]
    if others:
        log.note(
            "warning",
            "vbat_v",
            f"battery_status instances {', '.join(map(str, [instance, *others]))} are all connected"
            f" with a voltage: that of {instance} is used, its current is that of one battery",
        )
    left = ", ".join(str(k) for k in instances if k != instance)
    said = f"battery_status {instance}, connected and with a voltage; not {left}"
    return topic, said


def _volts(topic: Topic) -> Array:
    """Voltage, V, shape (n,): unfiltered where the log has it."""
    for name in ("voltage_v", "voltage_filtered_v"):
        if topic.has(name) and np.nanmax(topic.columns((name,)), initial=0.0) >= _LEAST_V:
            return topic.columns((name,))[:, 0]
    return np.zeros(len(topic.t_us))


def _battery_rank(log: Px4Log, topic: Topic) -> tuple[bool, bool, bool]:
    """Whether a battery is connected, fits the cells of its parameters, and changes its voltage."""
    volts = _volts(topic)
    connected = not topic.has("connected") or float(np.mean(topic.data["connected"])) > 0.5
    number = int(np.median(topic.data["id"])) if topic.has("id") else 1
    cells = log.params.get(f"BAT{number}_N_CELLS", log.params.get("BAT_N_CELLS", 0.0))
    middle = float(np.nanmedian(volts))
    fits = not cells > 0.0 or _CELL_V[0] < middle / cells < _CELL_V[1]
    return connected, fits, float(np.nanstd(volts)) > _SAGS_V
