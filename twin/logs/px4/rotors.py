"""Rotor speeds that the speed controllers report (esc_status), by the motor of each slot.

esc[k].actuator_function is 100 + motor since PX4 1.13. Where it is 0, a CAN controller's slot is
its index on the bus, which is UAVCAN_EC_FUNCk; before FUNC parameters index k was motor k.
Source: PX4, msg/EscReport.msg, drivers/dshot/DShot.cpp, drivers/uavcan/actuators/esc.cpp.
"""

from dataclasses import dataclass

import numpy as np

from ..assemble import Rows, add_signal
from ..columns import motor_columns
from ..flight import Array
from ..incidents import lower_voltage
from .log import Px4Log, Topic
from .outputs import FIRST_FUNCTION, MOST_FUNCTIONS, motor_count, motor_functions

_RPM_RAD_S = 2.0 * np.pi / 60.0
_SLOTS = 12
_CAN = 4
"""esc_connectiontype."""
_CAN_DRIVERS = ("UAVCAN_EC", "UCAN1_ESC")


@dataclass(frozen=True, slots=True)
class _Slot:
    """Reports of one motor's controller, and what says that they are its."""

    topic: Topic
    number: int
    source: str

    @property
    def rpm(self) -> Array:
        return self.topic.columns((f"esc[{self.number}].esc_rpm",))[:, 0]

    @property
    def volts(self) -> Array:
        """Supply voltage where the motor turns, V; none where the slot has no such field."""
        name = f"esc[{self.number}].esc_voltage"
        if not self.topic.has(name):
            return np.zeros(0)
        volts: Array = self.topic.columns((name,))[:, 0]
        return volts[np.abs(self.rpm) > 0.0]


def from_px4_rpm(rpm: Array) -> Array:
    """Rotor speed, rpm of either sign -> rad/s, not negative."""
    return np.abs(rpm) * _RPM_RAD_S


def add_rotors(log: Px4Log, rows: Rows, motors: int | None) -> dict[str, str]:
    """Rotor speeds of all motors, on the clock of the controllers of motor 1.

    Args:
        log: Takes the findings.
        rows: Takes the speeds.
        motors: Number of commands; None: there are none.

    Returns:
        Facts: the slot of each motor, and what says so.
    """
    topics = [t for k in log.instances("esc_status") if (t := log.topic("esc_status", k))]
    if not topics:
        return {}
    found, alive = _slots(log, topics)
    log.findings += lower_voltage({m: s.volts for m, s in found.items()})
    count = motors or motor_count(log) or len(found)
    lacking = [str(m) for m in range(1, count + 1) if m not in found]
    if lacking or not found:
        whose = f"of motor {', '.join(lacking)} of {count}" if alive and lacking else "of any motor"
        log.note(
            "warning",
            "rotor",
            f"left out: esc_status has no speed {whose} that changes",
            len(topics[0].t_us),
        )
        return {}
    slots = [found[m] for m in range(1, count + 1)]
    base = slots[0].topic
    speeds = [
        s.rpm if s.topic is base else np.interp(base.t_us, s.topic.t_us, s.rpm) for s in slots
    ]
    columns = motor_columns("rotor", count)
    add_signal(log, rows, "rotor", columns, base.t_us, from_px4_rpm(np.column_stack(speeds)))
    where = ", ".join(f"motor {m + 1} in slot {s.number + 1}" for m, s in enumerate(slots))
    said = ", ".join(dict.fromkeys(s.source for s in slots))
    return {"rotor speeds": f"esc_status, {where} ({said})"}


def _slots(log: Px4Log, topics: list[Topic]) -> tuple[dict[int, _Slot], int]:
    """Slot of each motor, from 1, and how many slots have a speed that changes."""
    found: dict[int, _Slot] = {}
    alive, guessed = 0, []
    for topic in topics:
        for k in range(_SLOTS):
            if not topic.has(f"esc[{k}].esc_rpm") or not _varies(topic, f"esc[{k}].esc_rpm"):
                continue
            alive += 1
            motor, source = _motor_of(log, topic, k)
            if motor and motor not in found:
                found[motor] = _Slot(topic, k, source)
            if source == _BY_PLACE:
                guessed.append(str(k + 1))
    if guessed:
        log.note(
            "warning",
            "rotor",
            f"no field says whose speeds slot {', '.join(guessed)} of esc_status holds "
            "(esc[].actuator_function is missing or 0): slot k taken for motor k",
        )
    return found, alive


_BY_PLACE = "by place"


def _motor_of(log: Px4Log, topic: Topic, slot: int) -> tuple[int, str]:
    """Motor of a slot, 0 where it is none, and what says so."""
    name = f"esc[{slot}].actuator_function"
    if topic.has(name):
        values, counts = np.unique(topic.data[name][topic.data[name] > 0], return_counts=True)
        if len(values):
            motor = int(values[counts.argmax()]) - FIRST_FUNCTION + 1
            return (motor if 1 <= motor <= MOST_FUNCTIONS else 0), "esc[].actuator_function"
    kind = topic.data.get("esc_connectiontype")
    functions = motor_functions(log.params)
    if kind is not None and np.median(kind) == _CAN:
        for driver in _CAN_DRIVERS:
            if any(d == driver for d, _ in functions):
                return functions.get((driver, slot), 0), f"{driver}_FUNCn, by index on the bus"
        if not functions:
            return slot + 1, "index on the CAN bus, the number of the motor before PX4 1.13"
    return slot + 1, _BY_PLACE


def _varies(topic: Topic, name: str) -> bool:
    """Whether a slot has speeds; a slot without a controller keeps 0."""
    return float(np.ptp(topic.data[name].astype(np.float64))) > 0.0
