"""Units and clocks of DataFlash messages where the log has none (before FMTU, ArduPilot 3.6).

One table for all releases: message and field, and where the releases differ the letter of the
field's format. Source: ArduPilot, LogStructure.h of DataFlash and AP_Logger and Log.cpp of
ArduCopter, 3.1 to 4.6, and what the functions that write the messages multiply by.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Quantity:
    """What fields of a message hold.

    Attributes:
        messages: Names, of instance 0.
        fields: Names.
        unit: ArduPilot's name of it, a key of `definitions.SI`.
        multiplier: Times which a number is in that unit, after the divisor of its format.
        by_letter: The same for single letters of the format.
    """

    messages: str
    fields: str
    unit: str
    multiplier: float = 1.0
    by_letter: Mapping[str, float] = field(default_factory=dict)


_HUNDREDTHS = {"h": 1e-2}
QUANTITIES = (
    Quantity("IMU", "GyrX GyrY GyrZ", "rad/s"),
    Quantity("IMU", "AccX AccY AccZ", "m/s/s"),
    Quantity("RATE", "R P Y RDes PDes YDes", "deg/s"),
    Quantity("MAG", "MagX MagY MagZ", "Gauss", 1e-3),
    Quantity("BARO", "Press", "Pa"),
    Quantity("ATT EKF1 NKF1 XKF1", "Roll Pitch Yaw DesRoll DesPitch DesYaw", "deg"),
    Quantity("NKQ XKQ", "Q1 Q2 Q3 Q4", "1"),
    Quantity("EKF1 NKF1 XKF1", "VN VE VD", "m/s"),
    Quantity("EKF1 NKF1 XKF1", "PN PE PD", "m"),
    Quantity("PSCN PSCE PSCD", "PN PE PD TPN TPE TPD", "m"),
    Quantity("PSCN PSCE PSCD", "VN VE VD TVN TVE TVD", "m/s"),
    Quantity("PSC", "PX PY", "m"),
    Quantity("PSC", "VX VY", "m/s"),
    Quantity("NTUN", "PosX PosY", "m", 1e-2),
    Quantity("NTUN", "VelX VelY", "m/s", 1e-2),
    Quantity("CTUN", "Alt", "m"),
    Quantity("CTUN", "CRt", "m/s", 1e-2),
    Quantity("BAT", "Volt", "V"),
    Quantity("BAT", "Curr", "A"),
    Quantity("CURR", "Volt", "V", by_letter=_HUNDREDTHS),
    Quantity("CURR", "Curr", "A", by_letter=_HUNDREDTHS),
    # `e` is rpm (4.0); `c`, up to 3.6, is a tenth of the rpm, divided by the 100 of its letter
    Quantity("ESC", "RPM", "rpm", by_letter={"c": 1e3}),
    Quantity("ESC", "Volt", "V"),
)
"""Frames are those of the flight table in every release, FRD and NED; what counts upwards (Alt and
CRt) changes its sign where it is read."""
_BY_FIELD = {(m, f): q for q in QUANTITIES for m in q.messages.split() for f in q.fields.split()}


def documented_unit(message: str, column: str, letter: str) -> tuple[str, float]:
    """Unit of a field by ArduPilot's history, and times which its number is in that unit.

    Args:
        message: Name, of instance 0.
        column: Field.
        letter: Of its format.
    """
    found = _BY_FIELD[message, column]
    return found.unit, found.by_letter.get(letter, found.multiplier)


def clock_of(columns: Mapping[str, object]) -> tuple[str, int] | None:
    """The column with the time since boot, and us in its unit; None where a message has none.

    GPS of Copter up to 3.2 has the time of the week as TimeMS, and that since boot as T. PARM, MSG,
    EV, ERR and MODE have no time up to 3.2.
    """
    if "TimeUS" in columns:
        return "TimeUS", 1
    if "TimeMS" in columns:
        return ("T" if "T" in columns else "TimeMS"), 1000
    return None


NAMES = {
    "MOT_SPIN_MAX": "MOT_THST_MAX",
    "MOT_BAT_VOLT_MAX": "MOT_THST_BAT_MAX",
    "MOT_BAT_VOLT_MIN": "MOT_THST_BAT_MIN",
}
"""Parameters that had another name up to Copter 3.4."""
FRAMES = {
    **{"QUAD": 1, "HEXA": 2, "OCTA": 3, "OCTA_QUAD": 4, "Y6": 5},
    **{"HELI": 6, "TRI": 7, "SINGLE": 8, "COAX": 9},
}
"""FRAME_CLASS by the message `Frame: QUAD`: up to Copter 3.4 each frame had its own firmware."""
