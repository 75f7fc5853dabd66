"""Betaflight Blackbox logs of any content, written as the firmware writes them; tests need no
recorded flight."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

Ints = NDArray[np.int64]
ZERO, PREVIOUS, LINE, AVERAGE, _, MOTOR_0, INC, HOME, MID, VBATREF, LAST, MINMOTOR = range(12)
SVB, UVB, NEG14, TAG8, TAG2, TAG4, NULL = 0, 1, 3, 6, 7, 8, 9
_PLAIN = (ZERO, SVB, PREVIOUS, SVB)
_NOISY = (ZERO, SVB, AVERAGE, SVB)
_DEFINITIONS: dict[str, tuple[int, int, int, int]] = {
    "loopIteration": (ZERO, UVB, INC, NULL),
    "time": (ZERO, UVB, LINE, SVB),
    "axisI": (ZERO, SVB, PREVIOUS, TAG2),
    "rcCommand": (ZERO, SVB, PREVIOUS, TAG4),
    "setpoint": (ZERO, SVB, PREVIOUS, TAG4),
    "vbatLatest": (VBATREF, NEG14, PREVIOUS, TAG8),
    "amperageLatest": (ZERO, SVB, PREVIOUS, TAG8),
    "baroAlt": (ZERO, SVB, PREVIOUS, TAG8),
    "rssi": (ZERO, UVB, PREVIOUS, TAG8),
    "gyroADC": _NOISY,
    "gyroUnfilt": _NOISY,
    "accSmooth": _NOISY,
    "imuQuaternion": _NOISY,
    "debug": _NOISY,
    "motor": (MOTOR_0, SVB, AVERAGE, SVB),
    "motor[0]": (MINMOTOR, UVB, AVERAGE, SVB),
    "servo": (MID, TAG8, PREVIOUS, TAG8),
    "eRPM": (ZERO, UVB, PREVIOUS, SVB),
}
"""As blackbox.c of Betaflight 4.5 has them: predictor and encoding of I and of P frames."""
_SLOW = {
    "flightModeFlags": (ZERO, UVB),
    "stateFlags": (ZERO, UVB),
    "failsafePhase": (ZERO, TAG2),
    "rxSignalReceived": (ZERO, TAG2),
    "rxFlightChannelsValid": (ZERO, TAG2),
}
_GPS = {
    "time": (LAST, UVB),
    "GPS_numSat": (ZERO, UVB),
    "GPS_coord[0]": (HOME, SVB),
    "GPS_coord[1]": (HOME, SVB),
    "GPS_altitude": (ZERO, SVB),
    "GPS_speed": (ZERO, UVB),
    "GPS_ground_course": (ZERO, UVB),
    "GPS_velned[0]": (ZERO, SVB),
    "GPS_velned[1]": (ZERO, SVB),
    "GPS_velned[2]": (ZERO, SVB),
}
SETTINGS: dict[str, str] = {
    "Firmware type": "Betaflight",
    "Firmware revision": "Betaflight 4.5.1 (77d01ba3b) STM32F7X2",
    "Log start datetime": "2025-06-01T10:00:00.000+00:00",
    "Craft name": "Rig",
    "I interval": "32",
    "P interval": "1",
    "gyro_scale": "0x3f800000",
    "motorOutput": "158,2047",
    "acc_1G": "2048",
    "vbatcellvoltage": "330,350,430",
    "vbatref": "1640",
    "motor_poles": "14",
    "acc_lpf_hz": "2500",
    "gyro_lpf1_static_hz": "0",
    "gyro_lpf2_static_hz": "500",
    "rpm_filter_harmonics": "3",
    "rpm_filter_min_hz": "100",
    "motor_pwm_protocol": "6",
    "blackbox_high_resolution": "0",
}


@dataclass(frozen=True)
class Part:
    """One flight of a file.

    Attributes:
        main: Integers by field; `time` in us, all of one length.
        settings: Over `SETTINGS`; "" takes one away.
        slow: (k, five numbers): written before main frame k.
        gps: (k, home or None, nine numbers behind the time): written after main frame k.
        events: (k, bytes behind the E): written before main frame k.
        ended: Whether the firmware wrote the end.
        first: Number of the first loop.
    """

    main: Mapping[str, ArrayLike]
    settings: Mapping[str, str] = field(default_factory=dict)
    slow: Sequence[tuple[int, Sequence[int]]] = ()
    gps: Sequence[tuple[int, Sequence[int] | None, Sequence[int]]] = ()
    events: Sequence[tuple[int, bytes]] = ()
    ended: bool = True
    first: int = 0


def uvb(value: int) -> bytes:
    """Bytes of 7 bits, the lowest first."""
    value &= 0xFFFFFFFF
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def svb(value: int) -> bytes:
    """The same of a number with sign."""
    value = (value + 2**31) % 2**32 - 2**31
    return uvb(value << 1 ^ value >> 31)


def tag8_8svb(values: Sequence[int]) -> bytes:
    """Up to eight numbers, zeros left out."""
    if len(values) == 1:
        return svb(values[0])
    tag = sum(1 << k for k, v in enumerate(values) if v)
    return bytes([tag]) + b"".join(svb(v) for v in values if v)


def _least(value: int, widths: Sequence[int], bits: int) -> int:
    """The smallest of some widths that a number with sign fits into.

    Raises:
        ValueError: It fits into none.
    """
    for width in widths:
        half = 1 << bits * width - 1
        if -half <= value < half:
            return width
    raise ValueError(f"{value} in {bits * widths[-1]} bits")


def tag2_3s32(values: Sequence[int]) -> bytes:
    """Three numbers in the least room."""
    low, high = min(values), max(values)
    if low >= -2 and high < 2:
        return bytes([(values[0] & 3) << 4 | (values[1] & 3) << 2 | values[2] & 3])
    if low >= -8 and high < 8:
        return bytes([64 | values[0] & 15, (values[1] & 15) << 4 | values[2] & 15])
    if low >= -32 and high < 32:
        return bytes([128 | values[0] & 63, values[1] & 63, values[2] & 63])
    tag, out = 192, b""
    for k, value in enumerate(values):
        width = _least(value, (1, 2, 3, 4), 8)
        tag |= (width - 1) << 2 * k
        out += value.to_bytes(width, "little", signed=True)
    return bytes([tag]) + out


def tag8_4s16(values: Sequence[int]) -> bytes:
    """Four numbers of 0, 4, 8 or 16 bits, half a byte at a time."""
    tag, halves = 0, ""
    for k, value in enumerate(values):
        kind = (0, 1, 2, 4).index(_least(value, (1, 2, 4), 4) if value else 0)
        width = (0, 1, 2, 4)[kind]
        tag |= kind << 2 * k
        halves += f"{value & (1 << 4 * width) - 1:0{width}x}" if width else ""
    return bytes([tag]) + bytes.fromhex(halves + "0" * (len(halves) % 2))


def _definition(name: str) -> tuple[int, int, int, int]:
    stem = name.partition("[")[0].partition("(")[0]
    return _DEFINITIONS.get(name, _DEFINITIONS.get(stem, _PLAIN))


def _head(part: Part, names: Sequence[str]) -> bytes:
    lines = ["Product:Blackbox flight data recorder by Nicholas Sherlock", "Data version:2"]
    rows = [_definition(n) for n in names]
    lines.append("Field I name:" + ",".join(names))
    for k, title in enumerate(("I predictor", "I encoding", "P predictor", "P encoding")):
        lines.append(f"Field {title}:" + ",".join(str(r[k]) for r in rows))
    others = {"S": _SLOW} | (
        {"H": {f"GPS_home[{k}]": (ZERO, SVB) for k in range(2)}, "G": _GPS} if part.gps else {}
    )
    for letter, fields in others.items():
        lines.append(f"Field {letter} name:" + ",".join(fields))
        lines.append(f"Field {letter} predictor:" + ",".join(str(p) for p, _ in fields.values()))
        lines.append(f"Field {letter} encoding:" + ",".join(str(e) for _, e in fields.values()))
    settings = SETTINGS | dict(part.settings)
    lines += [f"{name}:{value}" for name, value in settings.items() if value]
    return "".join(f"H {line}\n" for line in lines).encode("latin-1")


def _encoded(rest: Sequence[int], encodings: Sequence[int]) -> bytes:
    """Numbers in groups of one encoding."""
    out, at = b"", 0
    while at < len(rest):
        kind = encodings[at]
        count = {TAG2: 3, TAG4: 4}.get(kind, 1)
        while kind == TAG8 and count < 8 and encodings[at + count : at + count + 1] == [kind]:
            count += 1
        values = [int(v) for v in rest[at : at + count]]
        if kind == NEG14:
            out += uvb(-values[0] & 0x3FFF)
        elif kind != NULL:
            write: Any = {TAG8: tag8_8svb, TAG2: tag2_3s32, TAG4: tag8_4s16}.get(kind)
            out += write(values) if write else (svb if kind == SVB else uvb)(values[0])
        at += count
    return out


def _rest(
    now: Sequence[int],
    one: Sequence[int] | None,
    two: Sequence[int] | None,
    rows: Sequence[tuple[int, ...]],
    names: Sequence[str],
    settings: Mapping[str, str],
) -> list[int]:
    """What is left of a main frame when its prediction is taken off."""
    left = []
    for k, (predictor, *_rest_of) in enumerate(rows):
        value = now[k]
        if predictor == PREVIOUS and one is not None:
            value -= one[k]
        elif predictor == LINE and one is not None and two is not None:
            value -= 2 * one[k] - two[k]
        elif predictor == AVERAGE and one is not None and two is not None:
            value -= int((one[k] + two[k]) / 2)
        elif predictor == MOTOR_0:
            value -= now[names.index("motor[0]")]
        elif predictor == MINMOTOR:
            value -= int(settings["motorOutput"].split(",")[0])
        elif predictor == VBATREF:
            value -= int(settings["vbatref"])
        elif predictor == MID:
            value -= 1500
        left.append(value)
    return left


def _whole(values: ArrayLike) -> Ints:
    return np.round(np.asarray(values, dtype=np.float64)).astype(np.int64)


def _part(part: Part) -> bytes:
    columns = {n: _whole(v) for n, v in part.main.items()}
    n = len(columns["time"])
    settings = SETTINGS | dict(part.settings)
    every = int(settings["I interval"])
    step = int(settings["P interval"].rpartition("/")[2])
    loops = _loops(n, every, step, part.first)
    names = ["loopIteration", "time", *(c for c in columns if c != "time")]
    columns["loopIteration"] = np.array(loops)
    columns["time"] = columns["time"] % 2**32
    rows = np.column_stack([columns[c] for c in names]).tolist()
    definitions = [_definition(c) for c in names]
    intra, inter = [d[:2] for d in definitions], [d[2:] for d in definitions]
    out = [_head(part, names)]
    one = two = None
    slow, events = dict(part.slow), dict(part.events)
    gps = {k: (home, fix) for k, home, fix in part.gps}
    for k, now in enumerate(rows):
        if k in events:
            out.append(b"E" + events[k])
        if k in slow:
            out.append(b"S" + _encoded(slow[k], [e for _, e in _SLOW.values()]))
        whole = loops[k] % every == 0 or one is None
        kinds = intra if whole else inter
        rest = _rest(now, one, two, kinds, names, settings)
        out.append(b"IP"[not whole : 1 + (not whole)] + _encoded(rest, [e for _, e in kinds]))
        one, two = now, (now if whole else one)
        if k in gps:
            home, fix = gps[k]
            out.append(_fix(home, fix))
    return b"".join(out) + (b"E\xffEnd of log\0" if part.ended else b"")


def _fix(home: Sequence[int] | None, fix: Sequence[int]) -> bytes:
    """A fix; `fix[0]` is us after the main frame, coordinates are counted from the home."""
    out = b"" if home is None else b"H" + svb(home[0]) + svb(home[1])
    return out + b"G" + _encoded(fix, [e for _, e in _GPS.values()])


def _loops(n: int, every: int, step: int, first: int) -> list[int]:
    found: list[int] = []
    loop = first
    while len(found) < n:
        if loop % every % step == 0:
            found.append(loop)
        loop += 1
    return found


def blackbox(*parts: Part) -> bytes:
    """Bytes of a file of one flight after the other."""
    return b"".join(_part(p) for p in parts)


def mode_event(new: int, old: int) -> bytes:
    """A change of flight modes."""
    return bytes([30]) + uvb(new) + uvb(old)


def resume_event(loop: int, time_us: int) -> bytes:
    """Logging goes on after a pause."""
    return bytes([14]) + uvb(loop) + uvb(time_us)


def float_bits(value: float) -> str:
    """A number as Betaflight writes it into the head."""
    return f"0x{struct.unpack('<I', struct.pack('<f', value))[0]:x}"


MIXER = np.array(((-1.0, -1.0, 1.0, 1.0), (1.0, -1.0, 1.0, -1.0), (1.0, -1.0, -1.0, 1.0)))
"""What roll, pitch and yaw add to each motor: mixerQuadX of mixer.c, yaw turned as there."""
BOOT_US = 20_000_000
"""When the log begins, us since the firmware did."""


def flown_main(table: pd.DataFrame, high_resolution: bool = False) -> dict[str, ArrayLike]:
    """A flight as Betaflight 4.5 logs it: forward, left, up; degrees per second, 2048 for one g,
    DSHOT commands, a quaternion without its scalar part, height of the barometer in cm."""
    t = table["time"].to_numpy()
    scale = 10.0 if high_resolution else 1.0
    turned = np.array([1.0, -1.0, -1.0])
    gyro = np.rad2deg(table[[f"gyro_{a}" for a in "xyz"]].to_numpy()) * turned * scale
    acc = table[[f"acc_{a}" for a in "xyz"]].to_numpy() * turned * 2048 / 9.80665
    q = table[["q_w", "q_x", "q_y", "q_z"]].to_numpy()
    q = q * np.sign(np.where(q[:, :1] == 0.0, 1.0, q[:, :1]))
    main: dict[str, ArrayLike] = {"time": BOOT_US + 1e6 * t}
    cmd = table[[f"cmd_{i}" for i in range(1, 5)]].to_numpy()
    main |= {f"axisI[{k}]": 1000 * cmd @ row for k, row in enumerate(MIXER)}
    main |= {f"setpoint[{k}]": gyro[:, k] for k in range(3)} | {"setpoint[3]": 500 + 0 * t}
    main |= {"vbatLatest": 1630 - 2.0 * t, "amperageLatest": 1250 + 10 * np.sin(t)}
    height = 44330.0 * (1.0 - (table["baro_pa"].to_numpy() / 101325.0) ** 0.190295)
    main |= {"baroAlt": 100.0 * height}
    main |= {f"gyroADC[{k}]": gyro[:, k] for k in range(3)}
    main |= {f"accSmooth[{k}]": acc[:, k] for k in range(3)}
    main |= {f"imuQuaternion[{k}]": 32767 * q[:, k + 1] * turned[k] for k in range(3)}
    main |= {f"motor[{k}]": 48 + 1999 * table[f"cmd_{k + 1}"] for k in range(4)}
    main |= {f"eRPM[{k}]": 700 + 10 * k + 5 * np.sin(t) for k in range(4)}
    return main
