"""Flight logs: any format in, one flight table out."""

from .flight import Finding, Flight, Site
from .read import read_flight
from .table import write_flight

__all__ = ["Finding", "Flight", "Site", "read_flight", "write_flight"]
