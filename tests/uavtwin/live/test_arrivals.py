"""When datagrams came is told by when they came, not by when they were taken."""

import socket
import sys
import time

import pytest

from uavtwin.live.datagrams import Arrivals
from uavtwin.sockets import Address, listening


def opened() -> tuple[socket.socket, Arrivals]:
    listens = listening(Address("127.0.0.1", 0))
    return listens, Arrivals(listens)


def stamped(listens: socket.socket, arrivals: Arrivals, sender: socket.socket) -> None:
    """Wait until the kernel sets stamps, which it begins to do some time after it was asked."""
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline:
        sender.sendto(b"x", listens.getsockname())
        time.sleep(0.05)
        assert arrivals.wait(1.0)
        (found,) = arrivals.take(1)
        if time.monotonic() - found.at_s > 0.04:
            assert list(arrivals.take(1)) == []
            return
    pytest.fail("no stamp")


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel sets no stamp")
def test_taken_late_they_came_when_they_came() -> None:
    listens, arrivals = opened()
    with listens, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        stamped(listens, arrivals, sender)
        sent = []
        for k in range(3):
            before = time.monotonic(), time.time()
            sender.sendto(bytes([k]), listens.getsockname())
            sent.append((before, (time.monotonic(), time.time())))
            time.sleep(0.05)
        assert arrivals.wait(1.0)
        found = list(arrivals.take(10))
        own = sender.getsockname()[1]
    assert [d.content for d in found] == [b"\0", b"\1", b"\2"]
    for datagram, ((early_s, early), (late_s, late)) in zip(found, sent, strict=True):
        assert datagram.sender[1] == own
        assert early_s - 1e-3 <= datagram.at_s <= late_s + 1e-3
        assert early - 1e-3 <= 1e-6 * datagram.at_us <= late + 1e-3


def test_a_system_clock_that_is_set_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stamp from before all had been taken, or from later than now, is none."""
    listens, arrivals = opened()
    with listens, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        assert list(arrivals.take(10)) == []
        empty_s, real = time.monotonic(), time.time_ns
        for hours in (-1, 1):
            sender.sendto(b"x", listens.getsockname())
            assert arrivals.wait(1.0)
            monkeypatch.setattr(time, "time_ns", lambda h=hours: real() + h * 3_600_000_000_000)
            (found,) = arrivals.take(1)
            assert empty_s - 0.1 <= found.at_s <= time.monotonic()


def test_no_more_than_asked_for_at_once() -> None:
    listens, arrivals = opened()
    with listens, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for k in range(5):
            sender.sendto(bytes([k]), listens.getsockname())
        assert arrivals.wait(1.0)
        assert [len(list(arrivals.take(n))) for n in (2, 10, 10)] == [2, 3, 0]
        assert not arrivals.wait(0.0)
