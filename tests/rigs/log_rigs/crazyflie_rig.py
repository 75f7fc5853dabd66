"""Logs of a Crazyflie's uSD-card deck, of any content; tests need no recorded flight."""

import struct
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

Kinds = Mapping[str, Mapping[str, tuple[str, ArrayLike]]]
"""Per kind of events its variables, `group.name`: letter of `struct` and values; `t` is the time of
each in s since the log began."""
BOOT_MS = 5000


def usd_log(kinds: Kinds, version: int = 2, sealed: bool = True) -> bytes:
    """Bytes of a log.

    Args:
        kinds: What it holds.
        version: Of the format.
        sealed: With its checksum.
    """
    out = [struct.pack("<BHH", 0xBC, version, len(kinds))]
    rows: list[tuple[int, bytes]] = []
    for number, (name, variables) in enumerate(kinds.items(), start=7):
        letters = "".join(letter for n, (letter, _) in variables.items() if n != "t")
        out.append(struct.pack("<H", number) + name.encode() + b"\0")
        out.append(struct.pack("<H", len(letters)))
        named = [(n, v) for n, v in variables.items() if n != "t"]
        out += [f"{n}({letter})".encode() + b"\0" for n, (letter, _) in named]
        t_s = np.asarray(variables["t"][1], dtype=np.float64)
        unit = {1: 1e3, 2: 1e6}[version]
        stamps = (np.round(t_s * unit) + BOOT_MS * unit / 1e3).astype(np.int64).tolist()
        columns = [
            np.asarray(v) if letter in "fde" else np.round(np.asarray(v)).astype(np.int64)
            for _, (letter, v) in named
        ]
        shape = {1: "<HI", 2: "<HQ"}[version] + letters
        for k, stamp in enumerate(stamps):
            rows.append((stamp, struct.pack(shape, number, stamp, *(c[k] for c in columns))))
    rows.sort(key=lambda r: r[0])
    body = b"".join([*out, *(r[1] for r in rows)])
    return body + (struct.pack("<I", zlib.crc32(body)) if sealed else b"")


def decoded(blob: bytes) -> dict[str, dict[str, list[float]]]:
    """What a log holds, event by event with `struct` alone: a second implementation."""
    _, version, count = struct.unpack_from("<BHH", blob)
    at = 5
    found: dict[str, dict[str, list[float]]] = {}
    kinds = {}
    for _ in range(count):
        (number,) = struct.unpack_from("<H", blob, at)
        end = blob.index(0, at + 2)
        name = blob[at + 2 : end].decode()
        (several,) = struct.unpack_from("<H", blob, end + 1)
        at, names, letters = end + 3, [], ""
        for _ in range(several):
            end = blob.index(0, at)
            text = blob[at:end].decode()
            names.append(text[:-3])
            letters += text[-2]
            at = end + 1
        kinds[number] = (name, names, struct.Struct("<" + letters))
        found[name] = {n: [] for n in ("t_us", *names)}
    head = struct.Struct({1: "<HI", 2: "<HQ"}[version])
    while at < len(blob) - 4:
        number, stamp = head.unpack_from(blob, at)
        name, names, shape = kinds[number]
        at += head.size
        for n, value in zip(names, shape.unpack_from(blob, at), strict=True):
            found[name][n].append(value)
        found[name]["t_us"].append(stamp * {1: 1000, 2: 1}[version])
        at += shape.size
    return found


def _own_axes(values: Any) -> Any:
    """FRD or NED -> forward, left, up."""
    return np.asarray(values) * (1.0, -1.0, -1.0)


def flown_kinds(table: pd.DataFrame, small: bool = False, angles: bool = False) -> Kinds:
    """A flight as a Crazyflie logs it; `small`: of its compressed group; `angles`: of attitude."""
    t = table["time"].to_numpy()
    names = {"acc": 1.0 / 9.80665, "gyro": 180.0 / np.pi}
    fixed: dict[str, tuple[str, ArrayLike]] = {"t": ("d", t)}
    for group, factor in names.items():
        own = factor * _own_axes(table[[f"{group}_{a}" for a in "xyz"]])
        fixed |= {f"{group}.{a}": ("f", own[:, k]) for k, a in enumerate("xyz")}
    pos, vel = (_own_axes(table[[f"{s}_{a}" for a in "xyz"]]) for s in ("pos", "vel"))
    slow: dict[str, tuple[str, ArrayLike]] = {"t": ("d", t)}
    group, letter, factor = ("stateEstimateZ", "h", 1e3) if small else ("stateEstimate", "f", 1.0)
    slow |= {f"{group}.{a}": (letter, factor * pos[:, k]) for k, a in enumerate("xyz")}
    slow |= {f"{group}.v{a}": (letter, factor * vel[:, k]) for k, a in enumerate("xyz")}
    if angles:
        turned = Rotation.from_quat(table[["q_x", "q_y", "q_z", "q_w"]].to_numpy())
        yaw, pitch, roll = turned.as_euler("ZYX", degrees=True).T
        told = {"roll": roll, "pitch": pitch, "yaw": -yaw}
        slow |= {f"stabilizer.{k}": ("f", v) for k, v in told.items()}
    else:
        w, x, y, z = table[["q_w", "q_x", "q_y", "q_z"]].to_numpy().T
        told = {"qx": x, "qy": -y, "qz": -z, "qw": w}
        slow |= {f"stateEstimate.{k}": ("f", v) for k, v in told.items()}
    slow |= {f"motor.m{i}": ("H", 65535.0 * table[f"cmd_{i}"].to_numpy()) for i in range(1, 5)}
    slow |= {f"rpm.m{i}": ("H", np.full(len(t), 15000 + i)) for i in range(1, 5)}
    slow |= {"baro.pressure": ("f", 0.01 * table["baro_pa"].to_numpy())}
    slow |= {"pm.vbatMV": ("H", np.full(len(t), 3900))}
    slow |= {"supervisor.info": ("H", np.where((t > 2.0) & (t < 28.0), 0b10010, 0b10))}
    return {"fixedFrequency": fixed, "estimate": slow}
