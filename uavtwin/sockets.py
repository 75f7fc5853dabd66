"""Addresses in options, and their sockets."""

import contextlib
import os
import re
import socket
from dataclasses import dataclass

from twin.errors import TwinError

_FORM = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[^:\s\[\]/]+):([0-9]{1,5})")  # host and port
USUAL_PORTS = {"": 8080, "udpin": 14550, "udpout": 14550, "tcpin": 4560}
"""Default port by prefix of the address: of pages, ground stations and PX4's simulators."""
_FORCED = getattr(socket, "SO_RCVBUFFORCE", 33)
"""Socket option of Linux for administrators, without a name in Python."""
_BUFFER = 8 << 20
"""Receive buffer of the kernel, bytes: some seconds of a fast aircraft."""


@dataclass(frozen=True, slots=True)
class Address:
    """A host and a port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"

    @property
    def family(self) -> socket.AddressFamily:
        """Address family, IPv6 or IPv4."""
        return socket.AF_INET6 if ":" in self.host else socket.AF_INET

    @property
    def pair(self) -> tuple[str, int]:
        """The address in the form of Python's `socket`."""
        return self.host, self.port


def address(text: str, direction: str, option: str) -> Address:
    """The address in an option.

    Args:
        text: Address as the user wrote it.
        direction: Prefix of the host, a member of `USUAL_PORTS`.
        option: Option that gave the address.

    Raises:
        TwinError: It has another form.
    """
    given, _, place = text.partition(":") if direction else ("", "", text)
    match = _FORM.fullmatch(place)
    if match is None or given != direction or not 0 < int(match[2]) < 65536:
        before = f"{direction}:" if direction else ""
        example = f"{before}127.0.0.1:{USUAL_PORTS[direction]}"
        raise TwinError(f"{option} {text}: write {before}HOST:PORT, {example}.")
    return Address(match[1].strip("[]"), int(match[2]))


def listening(where: Address, connections: bool = False) -> socket.socket:
    """A socket that receives datagrams for an address, or accepts connections (TCP) there.

    Raises:
        TwinError: Another program uses it, or the address does not belong to this machine.
    """
    opened = socket.socket(where.family, socket.SOCK_STREAM) if connections else _socket(where)
    try:
        if connections and os.name == "posix":  # elsewhere it lets two programs listen
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind(where.pair)
        if connections:
            opened.listen(128)
    except OSError as error:
        opened.close()
        raise TwinError(
            f"{where}: cannot be listened at: {error.strerror or error}. Choose another port, or "
            f"end the program that listens there."
        ) from None
    return opened


def sending(where: Address) -> socket.socket:
    """A socket that sends to an address and receives its answers.

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
    opened = socket.socket(where.family, socket.SOCK_DGRAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
    with contextlib.suppress(OSError):  # beyond the limit for unprivileged users
        opened.setsockopt(socket.SOL_SOCKET, _FORCED, _BUFFER)
    opened.setblocking(False)
    return opened
