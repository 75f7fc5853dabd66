"""The supported log formats, one row each; the only place that describes formats.

A format consists of its reader, in a module of its own with the format's units and frames, and its
row in `FORMATS`. docs/dev/extending/log_format.md adds one step by step.
"""

import re
import string
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

from ..errors import LogError
from .flight import Flight

HEAD = 4096
"""Bytes from the start of a file that a signature may use."""
_TELLING = 4
"""Bytes of a longer signature after which a difference is damage, not another format."""
_LETTERS = string.ascii_letters.encode() + string.digits.encode() + b" :"
"""Bytes of text, which is no signature."""
_CENTURY_US = 946_684_800_000_000, 4_102_444_800_000_000  # 2000 to 2100, us since 1970
_BEFORE_TEXT = b"\xef\xbb\xbf \t\r\n\"'"  # byte-order mark, blanks, quotes


class Signature(Protocol):
    """Test of the first bytes of a file for one format."""

    def matches(self, head: bytes) -> bool:
        """Whether a file with these first bytes is of this format; `head` has at most `HEAD`
        bytes."""
        ...

    def damage(self, head: bytes) -> str:
        """Description of the damage to a signature, "" where the file is not similar to the
        format."""
        ...

    def __str__(self) -> str:
        """The signature as printed in the documentation."""
        ...


@dataclass(frozen=True, slots=True)
class Magic:
    """Fixed bytes at a fixed offset.

    Attributes:
        content: Expected bytes.
        at: Offset of the first byte.
    """

    content: bytes
    at: int = 0

    def matches(self, head: bytes) -> bool:
        """Whether the bytes are at that offset."""
        return head[self.at :].startswith(self.content)

    def damage(self, head: bytes) -> str:
        """Text for a file that ends within the signature, or with its later bytes changed."""
        if self.at or self.matches(head):
            return ""
        if 1 < len(head) < len(self.content) and self.content.startswith(head):
            return f"cut off after {len(head)} bytes"
        if len(self.content) > _TELLING and head.startswith(self.content[:_TELLING]):
            return "its signature is damaged"
        return ""

    def __str__(self) -> str:
        letters = len(self.content) - len(self.content.lstrip(_LETTERS))
        text, rest = self.content[:letters].decode("ascii"), self.content[letters:].hex(" ")
        parts = (f"`{text}`" if text else "", f"bytes {rest}" if rest else "")
        return " ".join(p for p in parts if p) + (f" at byte {self.at}" if self.at else "")


@dataclass(frozen=True, slots=True)
class FirstWord:
    """Text that begins with a word, in any case, after a byte-order mark, blanks and quotes."""

    word: bytes

    def matches(self, head: bytes) -> bool:
        """Whether the text begins with the word."""
        return head.lstrip(_BEFORE_TEXT).lower().startswith(self.word)

    def damage(self, head: bytes) -> str:
        """Always "": text has no signature that could be damaged."""
        return ""

    def __str__(self) -> str:
        return f"the word `{self.word.decode('ascii')}`"


@dataclass(frozen=True, slots=True)
class Stamped:
    """A time of this century, us since 1970 in 8 bytes, big-endian, followed by one of some
    bytes."""

    then: tuple[bytes, ...]

    def matches(self, head: bytes) -> bool:
        """Whether both are at the start."""
        return (
            head[8:].startswith(self.then)
            and _CENTURY_US[0] < int.from_bytes(head[:8]) < _CENTURY_US[1]
        )

    def damage(self, head: bytes) -> str:
        """Always "": a time alone does not identify a format."""
        return ""

    def __str__(self) -> str:
        then = " or ".join(each.hex(" ") for each in self.then)
        return f"a time, us since 1970 in 8 bytes, and byte {then}"


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Options of a caller for a reader; a reader ignores options that do not apply.

    Attributes:
        rebuild_commands: Re-run the autopilot's rate controller to get the motor commands at full
            rate. None: where they are logged slower than 100 Hz and the log contains the necessary
            signals.
    """

    rebuild_commands: bool | None = None


class Reader(Protocol):
    """Function that reads one format."""

    def __call__(self, path: Path, blob: bytes, options: ReadOptions) -> Flight:
        """A flight from the content of a file.

        Args:
            path: Name of the file, for messages.
            blob: Content of the file, which has the signature of the format.
            options: Options of the caller.

        Raises:
            LogError: The file cannot be used; the text states the reason and the remedy.
        """
        ...


@dataclass(frozen=True, slots=True)
class LogFormat:
    """One format of flight logs.

    Attributes:
        name: Name as printed.
        suffixes: Usual extensions of its files; they are printed, and do not decide on a format.
        signature: First bytes of its files; no file has the signatures of two formats.
        reader: `MODULE:FUNCTION` below `twin.logs`, imported when the first such file is read.
        packages: Distributions that the reader needs besides numpy and pandas.
        holds: Content of a flight from such a file, in one line.
        sought: Pattern at the start of the log that is specific enough to be searched behind bytes
            of another program; None: only the first bytes of the file count.
    """

    name: str
    suffixes: tuple[str, ...]
    signature: Signature
    reader: str
    packages: tuple[str, ...]
    holds: str
    sought: re.Pattern[bytes] | None = None

    def __str__(self) -> str:
        return f"{self.name} ({', '.join(self.suffixes)})" if self.suffixes else self.name

    def load(self) -> Reader:
        """The reader, imported.

        Raises:
            LogError: A package that the reader needs is not installed.
        """
        module, _, function = self.reader.partition(":")
        try:
            return cast(Reader, getattr(import_module(f".{module}", __package__), function))
        except ModuleNotFoundError as error:
            if error.name not in self.packages:
                raise
            raise LogError(
                f"{self.name} is read with {error.name}, which is not installed: "
                f"pip install {error.name}"
            ) from error


FORMATS: tuple[LogFormat, ...] = (
    LogFormat(
        name="PX4 ULog",
        suffixes=(".ulg",),
        signature=Magic(b"ULog\x01\x12\x35"),
        reader="px4.ulog:read_ulog",
        packages=("pyulog",),
        holds="whatever was logged; motor commands rebuilt where they were logged too slowly",
        sought=re.compile(rb"ULog\x01\x12\x35"),
    ),
    LogFormat(
        name="ArduPilot DataFlash",
        suffixes=(".bin",),
        signature=Magic(b"\xa3\x95"),
        reader="ardupilot.dataflash:read_dataflash",
        packages=(),
        holds="whatever was logged while the motors ran; rotor speeds of ESC telemetry",
        sought=re.compile(  # a definition: type, length, name of 2 to 4 letters, format
            rb"(?s)\xa3\x95\x80..[A-Z][A-Z0-9]{1,3}\0{0,2}[a-zA-Z]{2,16}\0"
        ),
    ),
    LogFormat(
        name="ArduPilot DataFlash, text",
        suffixes=(".log",),
        signature=FirstWord(b"fmt,"),
        reader="ardupilot.dataflash:read_dataflash",
        packages=(),
        holds="the same",
        sought=re.compile(rb"(?m)^FMT, *128,"),
    ),
    *(
        LogFormat(
            name=f"Crazyflie uSD log, version {version}",
            suffixes=(),
            signature=Magic(bytes([0xBC, version, 0])),
            reader="crazyflie:read_usd_log",
            packages=(),
            holds="of acc, gyro, mag, baro, stateEstimate, motor, rpm and pm what config.txt names",
        )
        for version in (1, 2)
    ),
    LogFormat(
        name="Betaflight Blackbox log",
        suffixes=(".bbl", ".bfl", ".TXT"),
        signature=Magic(b"H Product:Blackbox"),
        reader="betaflight.blackbox:read_blackbox",
        packages=(),
        holds="gyro, acceleration, motor outputs, rotor speeds, battery; mostly no course",
        sought=re.compile(rb"H Product:Blackbox"),
    ),
    LogFormat(
        name="MAVLink telemetry log",
        suffixes=(".tlog",),
        signature=Stamped((b"\xfe", b"\xfd")),
        reader="mavlink.log:read_tlog",
        packages=("pymavlink",),
        holds="what was sent of IMU, attitude, position, motor outputs, battery; often too seldom",
    ),
    LogFormat(
        name="ROS 2 bag, MCAP",
        suffixes=(".mcap",),
        signature=Magic(b"\x89MCAP0\r\n"),
        reader="ros.bag:read_mcap",
        packages=("rosbags",),
        holds="PX4's topics, MAVROS, IMU, odometry, battery; others by a mapping file",
    ),
    LogFormat(
        name="ROS 2 bag, SQLite",
        suffixes=(".db3",),
        signature=Magic(b"SQLite format 3\x00"),
        reader="ros.bag:read_sqlite",
        packages=("rosbags",),
        holds="the same; of ROS 2 before Iron the standard messages alone",
    ),
    LogFormat(
        name="flight table, Parquet",
        suffixes=(".parquet",),
        signature=Magic(b"PAR1"),
        reader="table:read_parquet",
        packages=("pyarrow",),
        holds="every column; facts and findings of the program that wrote it",
    ),
    LogFormat(
        name="flight table, Arrow stream",
        suffixes=(".arrows",),
        signature=Magic(b"\xff\xff\xff\xff"),
        reader="table:read_stream",
        packages=("pyarrow",),
        holds="the same, of a recording that was cut off: up to the last second",
    ),
    LogFormat(
        name="flight table, CSV",
        suffixes=(".csv",),
        signature=FirstWord(b"time"),
        reader="table:read_csv",
        packages=("pyarrow",),
        holds="every column",
    ),
)
"""Every log format, with its signature and its reader."""


OF_LOGS_ALONE = (".ulg", ".bbl", ".bfl", ".tlog")
"""Extensions of logs only: a file with one and without a known signature is a damaged log."""


def known_formats(formats: Sequence[LogFormat] = FORMATS) -> str:
    """All formats in one line, for errors and help."""
    return "; ".join(str(f) for f in formats)


def recognise(blob: bytes, formats: Sequence[LogFormat] = FORMATS) -> LogFormat | None:
    """The format of a file, by its first bytes; None where it has none of these.

    Raises:
        LogError: Two formats have this signature.
    """
    found = [f for f in formats if f.signature.matches(blob[:HEAD])]
    if len(found) > 1:
        raise LogError(
            f"begins like {' and like '.join(f.name for f in found)} and can be read as neither. "
            f"Write it again as one of: {known_formats(formats)}."
        )
    return found[0] if found else None


def damaged_signature(blob: bytes, formats: Sequence[LogFormat] = FORMATS) -> str:
    """Description of the damage to a file's signature, "" where it has no similar signature."""
    for each in formats:
        if damage := each.signature.damage(blob[:HEAD]):
            return f"{each.name}, {damage}"
    return ""
