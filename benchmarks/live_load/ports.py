"""Ports that nobody listens at."""

import socket

from uavtwin.live.address import Address


def free_address() -> Address:
    """One of the loopback."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_port:
        any_port.bind(("127.0.0.1", 0))
        return Address("127.0.0.1", any_port.getsockname()[1])
