"""Where MAVLink is sent to and listened for: `udpout:HOST:PORT`, `udpin:HOST:PORT`; simulators are
connected to at `tcpin:HOST:PORT`."""

import contextlib
import re
import socket
from dataclasses import dataclass

from twin.errors import TwinError

_FORM = re.compile(r"(udpin|udpout|tcpin):(\[[0-9A-Fa-f:.]+\]|[^:\s]+):([0-9]{1,5})")
USUAL_PORTS = {"udpin": 14550, "udpout": 14550, "tcpin": 4560}
"""Of ground stations, and of PX4's simulators."""
_FORCED = getattr(socket, "SO_RCVBUFFORCE", 33)
_BUFFER = 8 << 20
"""Bytes that the kernel may keep until they are read: some seconds of a fast aircraft."""


@dataclass(frozen=True, slots=True)
class Address:
    """A host and a port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"

    @property
    def pair(self) -> tuple[str, int]:
        """As sockets take it."""
        return self.host, self.port


def address(text: str, direction: str, option: str) -> Address:
    """The address of an option.

    Args:
        text: As given.
        direction: A member of `USUAL_PORTS`.
        option: By which it was given.

    Raises:
        TwinError: It is not of that form.
    """
    match = _FORM.fullmatch(text)
    if match is None or match.group(1) != direction or not 0 < int(match.group(3)) < 65536:
        example = f"{direction}:127.0.0.1:{USUAL_PORTS[direction]}"
        raise TwinError(f"{option} {text}: write {direction}:HOST:PORT, {example}.")
    return Address(match.group(2).strip("[]"), int(match.group(3)))


def listening(where: Address) -> socket.socket:
    """A socket that gets what is sent to an address.

    Raises:
        TwinError: Another program listens there, or the address is none of this machine.
    """
    opened = _socket(where)
    try:
        opened.bind(where.pair)
    except OSError as error:
        opened.close()
        raise TwinError(
            f"{where}: cannot be listened at: {error.strerror}. Choose another port, or end the "
            f"program that listens there."
        ) from None
    return opened


def sending(where: Address) -> socket.socket:
    """A socket that sends to an address and gets what is answered.

    Raises:
        TwinError: There is no such host.
    """
    opened = _socket(where)
    try:
        socket.getaddrinfo(where.host, where.port, opened.family, socket.SOCK_DGRAM)
    except OSError as error:
        opened.close()
        raise TwinError(f"{where}: cannot be sent to: {error.strerror}.") from None
    return opened


def _socket(where: Address) -> socket.socket:
    family = socket.AF_INET6 if ":" in where.host else socket.AF_INET
    opened = socket.socket(family, socket.SOCK_DGRAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    with contextlib.suppress(OSError):  # beyond what the system allows to everybody
        opened.setsockopt(socket.SOL_SOCKET, _FORCED, _BUFFER)
    opened.setblocking(False)
    return opened
