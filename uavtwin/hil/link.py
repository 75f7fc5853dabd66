"""TCP connection between one autopilot and the simulator."""

import contextlib
import select
import socket
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from twin.errors import TwinError
from twin.logs.mavlink.frames import BAD, MARKERS, Message, dialect, packed, parser

from ..sockets import Address, listening

SYSTEM = 1
"""System id of the simulator: that of the aircraft, as in PX4's own simulators."""
_WAIT_S = 0.1
"""Interval of checks whether to end, s. Made up."""
_LONGEST = 65536
"""Bytes that are read at once."""
_MOST_GARBAGE = 65536
"""Bytes without a valid message from which the peer is no MAVLink autopilot."""


class ConnectionEndedError(TwinError):
    """The autopilot has disconnected, or is no MAVLink autopilot."""


@dataclass(slots=True)
class Counts:
    """Counts of a connection.

    Attributes:
        sent: Number of messages to the autopilot.
        received: Number of messages from the autopilot.
        garbage: Number of bytes that belong to no message.
        wrong: Number of frames with a wrong checksum or length.
        refused: Number of connections refused because one existed.
    """

    sent: int = 0
    received: int = 0
    garbage: int = 0
    wrong: int = 0
    refused: int = 0


class AutopilotLink:
    """Waits for an autopilot, and accepts only the first one.

    Attributes:
        counts: Counts of the connection.
        peer: Connected autopilot, HOST:PORT; "": no connection.
    """

    def __init__(self, where: Address, patience_s: float) -> None:
        """Open the port.

        Args:
            where: Address of this machine.
            patience_s: Longest time until the autopilot accepts a message.

        Raises:
            TwinError: The address does not belong to this machine, or is in use.
        """
        self.counts, self.peer = Counts(), ""
        self._patience_s = patience_s
        self._packer = parser(SYSTEM, dialect.MAV_COMP_ID_AUTOPILOT1)
        self._reader = parser()
        self._peer: socket.socket | None = None
        self._door = listening(where, connections=True)

    @property
    def port(self) -> int:
        """Port number."""
        return int(self._door.getsockname()[1])

    def wait(self, stop: Callable[[], bool]) -> bool:
        """Wait until an autopilot connects; returns False if `stop` ended the wait."""
        while not stop():
            if select.select([self._door], [], [], _WAIT_S)[0]:
                peer, address = self._door.accept()
                peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                peer.settimeout(self._patience_s)
                self._peer, self.peer = peer, f"{address[0]}:{address[1]}"
                return True
        return False

    def send(self, messages: Iterable[Message]) -> None:
        """Send messages in one piece.

        Raises:
            ConnectionEndedError: The autopilot has disconnected, or accepts nothing.
        """
        assert self._peer is not None
        frames = b""
        for message in messages:
            frames += packed(message, self._packer)
            self.counts.sent += 1
        try:
            self._peer.sendall(frames)
        except TimeoutError:
            raise ConnectionEndedError(
                f"the autopilot at {self.peer} has read nothing for {self._patience_s:g} s"
            ) from None
        except OSError as error:
            raise ConnectionEndedError(
                f"the connection to the autopilot at {self.peer} is lost: {error.strerror}"
            ) from None

    def messages(self, wait_s: float) -> list[Message]:
        """Messages of the autopilot that have arrived, or arrive within a time.

        Raises:
            ConnectionEndedError: It has closed the connection, or does not use MAVLink.
        """
        assert self._peer is not None
        until = time.monotonic() + wait_s
        while True:
            left = max(until - time.monotonic(), 0.0)
            ready = select.select([self._peer, self._door], [], [], left)[0]
            if self._door in ready:
                self._refuse()
            if self._peer in ready:
                return self._read(self._peer)
            if left == 0.0 or not ready:
                return []

    def _read(self, peer: socket.socket) -> list[Message]:
        try:
            octets = peer.recv(_LONGEST)
        except OSError as error:
            raise ConnectionEndedError(
                f"the connection to the autopilot at {self.peer} is lost: {error.strerror}"
            ) from None
        if not octets:
            raise ConnectionEndedError(f"the autopilot at {self.peer} has closed the connection")
        found = []
        for message in self._reader.parse_buffer(octets) or ():
            if message.get_type() != BAD:
                found.append(message)
                continue
            frame = bytes(message.get_msgbuf())
            is_frame = frame[:1] and frame[0] in MARKERS
            self.counts.wrong += bool(is_frame)
            self.counts.garbage += 0 if is_frame else len(frame)
        self.counts.received += len(found)
        if not self.counts.received and self.counts.garbage > _MOST_GARBAGE:
            raise ConnectionEndedError(
                f"{self.peer} has sent {self.counts.garbage} bytes and not one MAVLink message: it "
                f"is no autopilot"
            )
        return found

    def _refuse(self) -> None:
        """Refuse a further connection: one aircraft has one autopilot."""
        with contextlib.suppress(OSError):
            late, _ = self._door.accept()
            late.close()
            self.counts.refused += 1

    def close(self) -> None:
        """Close the connection and the port."""
        if self._peer is not None:
            self._peer.close()
        self._door.close()
