"""The mapping file of a ROS 2 bag, which assigns topics to signals of a flight.

Only checks that do not need the bag; `twin.logs.ros.sources` checks it against the topics of the
bag.
"""

import tomllib
from pathlib import Path

import msgspec

from .errors import LogError

MAPPING_SUFFIX = ".topics.toml"
"""Extension of the file: `flight.mcap` has `flight.topics.toml`."""
MOST_MAPPING = 64_000
"""Largest size of the file, bytes: a thousand signals."""
BAG_SUFFIXES = (".mcap", ".db3")
"""Extensions of the bags to which it may belong."""


class MappedSignal(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A signal in a mapping file.

    Attributes:
        topic: Name of the topic.
        fields: Paths of fields in a message: "linear_acceleration.x", "channels[0]"; for an
            attitude w, x, y, z in the frame NED-FRD, x, y, z, w in ENU-FLU.
        frame: Frame of a vector or an attitude.
        unit: Unit of the values; default: that of the flight table.
        low: Value of command 0, for `cmd`.
        high: Value of command 1, for `cmd`.
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
        file: Path of the mapping file.
        name: Original name, for errors.

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
