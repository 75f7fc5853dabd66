"""Addresses and who can reach them."""

import socket

import pytest

from twin.errors import TwinError
from uavtwin.sockets import Address, listening


def test_every_address_of_a_machine_takes_connections_by_ipv4_too() -> None:
    try:
        server = listening(Address("::", 0), connections=True)
    except (OSError, TwinError):
        pytest.skip("no IPv6 here")
    with server:
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port), timeout=60) as client:
            server.settimeout(60)
            accepted, (host, *_) = server.accept()
            with accepted:
                client.sendall(b"x")
                assert accepted.recv(1) == b"x" and host == "::ffff:127.0.0.1"


def test_an_address_of_another_machine_is_told() -> None:
    with pytest.raises(TwinError, match=r"at: Cannot assign requested address\."):
        listening(Address("203.0.113.9", 4560), connections=True)
