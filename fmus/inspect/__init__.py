"""FMUs of any origin looked at: nothing is unpacked, no library is loaded."""

from .report import FmuReport, brief, inspect_fmu

__all__ = ["FmuReport", "brief", "inspect_fmu"]
