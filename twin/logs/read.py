"""Open a flight, whatever its format."""

from pathlib import Path

from ..errors import LogError
from .flight import Flight
from .px4.log import MAGIC
from .px4.ulog import read_ulog
from .table import read_table

_FORMATS = "a PX4 log (.ulg) or a flight table (.parquet or .csv, see docs/guide/flight_table.md)"


def read_flight(path: str | Path, *, rebuild_commands: bool | None = None) -> Flight:
    """Read a flight log or flight table; the format is told by the first bytes.

    Args:
        path: File.
        rebuild_commands: For PX4 logs: re-run the rate controller to get the motor commands at
            full rate. None: where they are logged slower than 100 Hz and the log has what it takes.

    Raises:
        LogError: The file cannot be used; the text says why and what to do.
    """
    path = Path(path)
    blob = _content(path)
    if blob.startswith(MAGIC):
        return read_ulog(path, blob, rebuild_commands)
    if blob.startswith(b"PAR1"):
        return read_table(path, blob)
    if blob.lstrip(b"\xef\xbb\xbf \t\"'").lower().startswith(b"time"):
        return read_table(path, blob)
    raise LogError(f"{path.name}: {_looks_like(blob)} Give {_FORMATS}.")


def _content(path: Path) -> bytes:
    """Bytes of the file."""
    try:
        blob = path.read_bytes()
    except FileNotFoundError:
        raise LogError(f"{path}: there is no such file.") from None
    except IsADirectoryError:
        raise LogError(f"{path}: this is a folder. Give {_FORMATS}.") from None
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read: {error}.") from None
    if not blob:
        raise LogError(f"{path.name}: the file is empty (0 bytes). Copy the log again.")
    return blob


def _looks_like(blob: bytes) -> str:
    """One sentence on what the file seems to be."""
    if MAGIC.startswith(blob[: len(MAGIC)]) and len(blob) < len(MAGIC):
        return f"a PX4 ULog cut off after {len(blob)} bytes. Copy the log again."
    if blob.startswith(b"ULog"):
        return "starts like a PX4 ULog but its signature is damaged. Copy the log again."
    if blob.startswith(b"\xa3\x95"):
        return (
            "an ArduPilot DataFlash log, which is not read yet. Convert it to a flight table, "
            "for example with pymavlink's mavlogdump.py."
        )
    if blob.startswith(b"PK\x03\x04"):
        return "a ZIP archive (or FMU). Unpack it first."
    if blob.startswith(b"\x1f\x8b"):
        return "gzip-compressed. Unpack it first."
    if blob[:1] == b"\xfd" or blob[8:9] == b"\xfe":
        return "perhaps a MAVLink telemetry log, which lacks the rates needed here."
    head = blob[:64]
    if all(32 <= b < 127 or b in b"\t\r\n" for b in head):
        line = head.splitlines()[0].decode("ascii")[:40] if head.strip() else ""
        return f"text that begins with '{line}', not with a column 'time'."
    return f"no known flight log (it begins with {blob[:4].hex(' ')})."
