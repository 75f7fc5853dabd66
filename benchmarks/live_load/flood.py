"""Datagrams beside an aircraft, as fast as asked for, from a process of their own."""

import multiprocessing
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np

from twin.logs.mavlink.encode import messages_of
from twin.logs.mavlink.frames import AUTOPILOT, parser
from uavtwin.sockets import Address

FLOODS = ("garbage", "valid", "damaged")
"""Random bytes; messages of another aircraft; the same with a wrong checksum."""
_SYSTEM = 7
"""System id of the other aircraft."""
_LARGEST = 1200
"""Bytes of a datagram, at most: below the MTU of Ethernet."""
_DIFFERENT = 256
"""Number of different datagrams, sent in turn."""
_NUMBERS = 256
"""Sequence numbers of MAVLink, one byte."""
_PAUSE_S = 0.005
"""Between two bursts, s. Made up."""


@dataclass(frozen=True, slots=True)
class Flood:
    """A flood that is on.

    Attributes:
        process: That sends it.
        count: Bytes that it has sent.
    """

    process: BaseProcess
    count: Any

    def sent_bytes(self) -> int:
        """So far."""
        return int(self.count.value)


@contextmanager
def flooding(to: Address, kind: str, bytes_per_s: float) -> Iterator[Flood]:
    """Send until the block ends.

    Args:
        to: Whom.
        kind: A member of `FLOODS`.
        bytes_per_s: How much.
    """
    context = multiprocessing.get_context("spawn")
    count = context.Value("q", 0, lock=False)  # a sender that is ended would keep the lock
    process = context.Process(target=_send, args=(to, kind, bytes_per_s, count), daemon=True)
    process.start()
    try:
        while count.value == 0 and process.is_alive():
            time.sleep(0.01)
        yield Flood(process, count)
    finally:
        process.terminate()
        process.join()


def _send(to: Address, kind: str, bytes_per_s: float, count: Any) -> None:
    """Send for ever, some datagrams at a time."""
    datagrams = cycle(_datagrams(kind))
    began, sent = time.monotonic(), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        while True:
            due = bytes_per_s * (time.monotonic() - began)
            while sent < due:
                datagram = next(datagrams)
                out.sendto(datagram, to.pair)
                sent += len(datagram)
                count.value = sent
            time.sleep(_PAUSE_S)


def _datagrams(kind: str) -> list[bytes]:
    """Datagrams to be sent again and again; packing them each time would be too slow."""
    rng, packer = np.random.default_rng(1), parser(_SYSTEM, AUTOPILOT)
    if kind == "garbage":
        return [rng.bytes(_LARGEST) for _ in range(_DIFFERENT)]
    found, datagram = [], b""
    for k in range(_NUMBERS * _DIFFERENT // 16):
        (m,) = messages_of(1000 * k, {"acc_x": 99.0, "acc_y": 0.0, "acc_z": 0.0}, 4)
        frame = bytearray(m.pack(packer))
        packer.seq = (packer.seq + 1) % _NUMBERS
        frame[-1] ^= 1 if kind == "damaged" else 0
        datagram += bytes(frame)
        if len(datagram) > _LARGEST - 100:
            found.append(datagram)
            datagram = b""
    return found
