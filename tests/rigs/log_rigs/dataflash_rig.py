"""ArduPilot DataFlash logs of any content, binary or text; tests need no recorded flight."""

import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

MARK = b"\xa3\x95"
_CODES = {
    **{"b": "b", "B": "B", "M": "B", "h": "h", "H": "H", "i": "i", "I": "I", "q": "q", "Q": "Q"},
    **{"f": "f", "d": "d", "n": "4s", "N": "16s", "Z": "64s"},
    **{"c": "h", "C": "H", "e": "i", "E": "I", "L": "i"},
}
_TIMES = {"c": 1e2, "C": 1e2, "e": 1e2, "E": 1e2, "L": 1e7}
_UNITS = {
    **{"s": "s", "d": "deg", "h": "degheading", "k": "deg/s", "E": "rad/s", "m": "m", "n": "m/s"},
    **{"o": "m/s/s", "G": "Gauss", "P": "Pa", "v": "V", "A": "A", "q": "rpm", "Y": "us"},
    **{"D": "deglatitude", "U": "deglongitude", "#": "instance", "-": "", "?": "UNKNOWN"},
}
_MULTIPLIERS = {"F": 1e-6, "C": 1e-3, "B": 1e-2, "0": 1.0, "-": 0.0, "?": 1.0, "G": 1e-7}


@dataclass(frozen=True)
class Kind:
    """One kind of message as ArduPilot 4.5 defines it."""

    letters: str
    columns: str
    units: str = ""
    multipliers: str = ""

    @property
    def names(self) -> list[str]:
        return self.columns.split(",")


KINDS = {
    "FMT": Kind("BBnNZ", "Type,Length,Name,Format,Columns", "-b---", "-----"),
    "UNIT": Kind("QbZ", "TimeUS,Id,Label", "s--", "F--"),
    "FMTU": Kind("QBNN", "TimeUS,FmtType,UnitIds,MultIds", "s---", "F---"),
    "MULT": Kind("Qbd", "TimeUS,Id,Mult", "s--", "F--"),
    "PARM": Kind("QNff", "TimeUS,Name,Value,Default", "s---", "F---"),
    "MSG": Kind("QZ", "TimeUS,Message", "s-", "F-"),
    "IMU": Kind("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "s#EEEooo", "F-000000"),
    "ATT": Kind("Qccc", "TimeUS,Roll,Pitch,Yaw", "sddh", "FBBB"),
    "XKQ": Kind("QBffff", "TimeUS,C,Q1,Q2,Q3,Q4", "s#????", "F-????"),
    "XKF1": Kind("QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD", "s#nnnmmm", "F-000000"),
    "XKF4": Kind("QBb", "TimeUS,C,PI", "s#-", "F--"),
    "XKFS": Kind("QBBBBB", "TimeUS,C,MI,BI,GI,AI", "s#----", "F-----"),
    "RCOU": Kind("QHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8", "sYYYYYYYY", "F--------"),
    "RATE": Kind("Qfffffff", "TimeUS,R,ROut,P,POut,Y,YOut,AOut", "sk-k-k--", "F-------"),
    "BARO": Kind("QBff", "TimeUS,I,Alt,Press", "s#mP", "F-00"),
    "MAG": Kind("QBhhh", "TimeUS,I,MagX,MagY,MagZ", "s#GGG", "F-CCC"),
    "BAT": Kind("QBff", "TimeUS,Inst,Volt,Curr", "s#vA", "F-00"),
    "GPS": Kind("QBBIHLLe", "TimeUS,I,Status,GMS,GWk,Lat,Lng,Alt", "s#-s-DUm", "F-----GGB"),
    "ESC": Kind("QBf", "TimeUS,Instance,RPM", "s#q", "F-0"),
    "MOTB": Kind("QffB", "TimeUS,LiftMax,BatVolt,FailFlags", "s-v-", "F---"),
    "EV": Kind("QB", "TimeUS,Id", "s-", "F-"),
    "MODE": Kind("QMB", "TimeUS,Mode,ModeNum", "s--", "F--"),
    "ERR": Kind("QBB", "TimeUS,Subsys,ECode", "s--", "F--"),
    "DSF": Kind("QI", "TimeUS,Dp", "s-", "F-"),
    "VIBE": Kind("QBI", "TimeUS,IMU,Clip", "s#-", "F--"),
    "PSCN": Kind("Qff", "TimeUS,PN,VN", "smn", "F00"),
    "PSCE": Kind("Qff", "TimeUS,PE,VE", "smn", "F00"),
    "PSCD": Kind("Qff", "TimeUS,PD,VD", "smn", "F00"),
    "POS": Kind("QLLf", "TimeUS,Lat,Lng,Alt", "sDUm", "FGG0"),
}
Row = tuple[str, tuple[Any, ...]]
Columns = Mapping[str, ArrayLike]


def dataflash(
    messages: Mapping[str, Columns | Iterable[Columns]],
    params: Mapping[str, float] | None = None,
    start_us: int = 5_000_000,
    text: bool = False,
    units: bool = True,
    kinds: Mapping[str, Kind] = KINDS,
) -> bytes:
    """Bytes of a log.

    Args:
        messages: By name the columns of its messages, or several of these, of several instances;
            `t` is the time in s after the start, also of messages that have none in the file;
            numbers as they are meant, columns left out are 0.
        params: Parameters.
        start_us: Time since boot at which it begins, us.
        text: As text.
        units: Whether it has FMTU, UNIT and MULT.
        kinds: Definitions of the messages.
    """
    out = [*_head(messages, params or {}, start_us, units, kinds)]
    rows: list[tuple[int, int, Row]] = []
    assert all(k in kinds for k in messages)
    for name, given in messages.items():
        for columns in [given] if isinstance(given, Mapping) else given:
            rows += _rows(name, kinds[name], columns, start_us, len(rows))
    rows.sort(key=lambda r: r[:2])
    write = _line if text else message
    return b"".join(write(*row, kinds) for row in [*out, *(r[2] for r in rows)])


def _number(name: str, kinds: Mapping[str, Kind]) -> int:
    return 0x80 if name == "FMT" else 1 + list(kinds).index(name)


def _head(
    messages: Mapping[str, Any],
    params: Mapping[str, float],
    start_us: int,
    units: bool,
    kinds: Mapping[str, Kind],
) -> Iterator[Row]:
    used = ["FMT", *(("UNIT", "FMTU", "MULT") if units else ()), "PARM", *messages]
    used = list(dict.fromkeys(used))
    for name in used:
        kind = kinds[name]
        size = 3 + struct.calcsize("<" + "".join(_CODES[k] for k in kind.letters))
        yield "FMT", (_number(name, kinds), size, name, kind.letters, kind.columns)
    if units:
        yield from (("UNIT", (start_us, ord(k), v)) for k, v in _UNITS.items())
        yield from (("MULT", (start_us, ord(k), v)) for k, v in _MULTIPLIERS.items())
        for name in used:
            kind = kinds[name]
            yield "FMTU", (start_us, _number(name, kinds), kind.units, kind.multipliers)
    names = kinds["PARM"].names
    for k, v in params.items():
        given = {**_clock(start_us), "Name": k, "Value": v, "Default": v}
        yield "PARM", tuple(given[n] for n in names)


def _rows(
    name: str, kind: Kind, columns: Columns, start_us: int, first: int
) -> list[tuple[int, int, Row]]:
    given = {k: np.asarray(v) for k, v in columns.items()}
    stamps = np.round(np.atleast_1d(given.pop("t")) * 1e6).astype(np.int64) + start_us
    given = {k: v for k, v in _clock(stamps).items() if k in kind.names} | given
    none = np.zeros(len(stamps))
    full = [np.broadcast_to(given.pop(c, none), len(stamps)).tolist() for c in kind.names]
    assert not given, f"{name} has no columns {set(given)}"
    values = enumerate(zip(*full, strict=True))
    return [(int(stamps[k]), first + k, (name, v)) for k, v in values]


def _clock(stamp_us: Any) -> dict[str, Any]:
    """Time since boot as one release or another has it; another value can be given instead."""
    return {"TimeUS": stamp_us, "TimeMS": stamp_us // 1000, "T": stamp_us // 1000}


def message(name: str, values: tuple[Any, ...], kinds: Mapping[str, Kind] = KINDS) -> bytes:
    """One message of a binary log."""
    letters = kinds[name].letters
    packed = []
    for letter, value in zip(letters, values, strict=True):
        if isinstance(value, str):
            packed.append(value.encode())
        elif letter in "fd":
            packed.append(value)
        else:
            packed.append(round(value * _TIMES.get(letter, 1.0)))
    content = struct.pack("<" + "".join(_CODES[k] for k in letters), *packed)
    return MARK + bytes([_number(name, kinds)]) + content


def _line(name: str, values: tuple[Any, ...], kinds: Mapping[str, Kind]) -> bytes:
    told = []
    for letter, value in zip(kinds[name].letters, values, strict=True):
        whole = letter in "bBMhHiIqQ" and not isinstance(value, str)
        if letter in _TIMES:
            value = round(value * _TIMES[letter]) / _TIMES[letter]
        told.append(str(round(value)) if whole else str(value))
    return (", ".join([name, *told]) + "\n").encode()
