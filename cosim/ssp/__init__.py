"""SSP, the standard format of connected FMUs: `.ssp` = SSD (structure) + SSV (start values)."""

from .read import read_ssp
from .write import write_ssp

__all__ = ["read_ssp", "write_ssp"]
