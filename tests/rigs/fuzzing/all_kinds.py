"""The kinds of files that are changed and read; a new one is its module and its row here."""

from importlib import import_module
from typing import cast

from .engine import Kind

KINDS = {
    "ulog": "ulog",
    "dataflash": "dataflash",
    "blackbox": "cards.blackbox",
    "crazyflie": "cards.crazyflie",
    "tlog": "messages:TLOG",
    "datagrams": "messages:DATAGRAMS",
    "parquet": "tables:PARQUET",
    "csv": "tables:CSV",
    "vehicle": "vehicles:VEHICLES",
    "design": "vehicles:DESIGNS",
    "fmu": "archives:FMU",
    "ssp": "archives:SSP",
    "onnx": "networks",
}
"""Module below this package, and the name of the object where it is not `KIND`."""

_OF_THE_TESTS = {"faulty": "faulty"}


def kind(name: str) -> Kind:
    """A kind by its name."""
    module, _, attribute = (KINDS | _OF_THE_TESTS)[name].partition(":")
    return cast(Kind, getattr(import_module(f".{module}", __package__), attribute or "KIND"))
