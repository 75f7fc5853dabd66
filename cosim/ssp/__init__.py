"""SSP, the standard format of connected FMUs: `.ssp` = SSD (structure) + SSV (start values)."""

from .inspect import SspReport, inspect_ssp
from .read import read_ssp
from .write import write_ssp

__all__ = ["SspReport", "inspect_ssp", "read_ssp", "write_ssp"]
