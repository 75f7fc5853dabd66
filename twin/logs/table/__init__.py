"""The flight table as a file: Parquet, or CSV with the same header.

`twin.logs.columns.COLUMNS` is the definition of the table; `validate.validate` what is checked.
"""

from .read import header, open_parquet, read_csv, read_parquet
from .write import check_suffix, write_flight

__all__ = [
    "check_suffix",
    "header",
    "open_parquet",
    "read_csv",
    "read_parquet",
    "write_flight",
]
