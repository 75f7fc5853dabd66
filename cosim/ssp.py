"""SSP, the standard format of connected FMUs: `.ssp` = SSD (structure) + SSV (start values)."""

from .ssp_read import read_ssp
from .ssp_write import write_ssp

__all__ = ["read_ssp", "write_ssp"]
