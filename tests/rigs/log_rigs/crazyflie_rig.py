"""Logs of a Crazyflie's uSD-card deck, of any content; tests need no recorded flight."""

import struct
import zlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

BOOT_MS = 5000


def usd_log(
    kinds: Mapping[str, Mapping[str, tuple[str, ArrayLike]]], version: int = 2, sealed: bool = True
) -> bytes:
    """Bytes of a log.

    Args:
        kinds: Per kind of events its variables, `group.name`: letter of `struct` and values; `t` is
            the time of each in s since the log began.
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
