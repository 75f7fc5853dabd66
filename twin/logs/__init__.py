"""Flight logs: any format in, one flight table out."""

from .flight import Finding, Flight, Site
from .read import open_flight, read_flight
from .stored import AnyFlight, StoredFlight
from .table import write_flight

__all__ = [
    "AnyFlight",
    "Finding",
    "Flight",
    "Site",
    "StoredFlight",
    "open_flight",
    "read_flight",
    "write_flight",
]
