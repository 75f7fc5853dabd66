"""The mapping file of a ROS 2 bag: which of its topics are which signals of a flight.

What can be told without the bag; `twin.logs.ros.sources` holds it against the topics that are
there.
"""

import tomllib
from pathlib import Path

import msgspec

from .errors import LogError

MAPPING_SUFFIX = ".topics.toml"
"""Ending of the file: `flight.mcap` has `flight.topics.toml`."""
MOST_MAPPING = 64_000
"""Bytes of it: a thousand signals."""
BAG_SUFFIXES = (".mcap", ".db3")
"""Of the bags that it may belong to."""


class MappedSignal(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A signal in a mapping file.

    Attributes:
        topic: Name.
        fields: Of a message, by path: "linear_acceleration.x", "channels[0]"; of an attitude w, x,
            y, z in the frame NED-FRD, x, y, z, w in ENU-FLU.
        frame: Of a vector or an attitude.
        unit: Of the values; that of the flight table where it is left out.
        low: Value of command 0, of `cmd`.
        high: Value of command 1, of `cmd`.
    """

    topic: str
    fields: list[str]
    frame: str = ""
    unit: str = ""
    low: float = 0.0
    high: float = 1.0


def mapping_of(log: Path) -> Path | None:
    """The mapping file next to a log; None: there is none."""
    file = log.with_suffix(MAPPING_SUFFIX)
    return file if file.is_file() else None


def read_mapping(file: Path, name: str) -> dict[str, MappedSignal]:
    """Signals of a mapping file, by name.

    Args:
        file: To be read.
        name: By which its owner knows it, for errors.

    Raises:
        LogError: It is no mapping, or too large.
    """
    try:
        with file.open("rb") as opened:
            content = opened.read(MOST_MAPPING + 1)
        if len(content) > MOST_MAPPING:
            raise ValueError(f"over {MOST_MAPPING} bytes")
        return msgspec.convert(tomllib.loads(content.decode()), dict[str, MappedSignal])
    except (OSError, ValueError, RecursionError) as error:
        raise LogError(
            f"{name}: no mapping of topics: {error}. Write a table for each signal, such as "
            f'[acc] with topic = "/imu" and fields = ["linear_acceleration.x", ...].'
        ) from error
