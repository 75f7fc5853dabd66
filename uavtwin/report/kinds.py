"""Physical quantities of channels: what a page calls them, and which of them share a figure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from twin.physics.sensors.table import BODY, SENSORS, Sensor
from twin.residuals.gap import Channel


@dataclass(frozen=True, slots=True)
class Kind:
    """A physical quantity.

    Attributes:
        prefix: Its channels begin with it.
        title: Of its figures.
        axes: Names of its axes.
        words: It in a sentence.
        axis: Words for an axis, by its letter.
    """

    prefix: str
    title: str
    axes: str = ""
    words: str = ""
    axis: Mapping[str, str] = field(default_factory=dict)


def _of_sensor(sensor: Sensor) -> Kind:
    """Kind of the readings of a sensor beside the IMU."""
    vector = len(sensor.columns) > 1
    axes, axis = ("body axes", _BODY) if vector else ("", {})
    return Kind(f"{sensor.signal}_", sensor.title, axes, sensor.words, axis)


_BODY = {"x": "forward axis", "y": "right axis", "z": "down axis"}
_TURN = {"x": "roll", "y": "pitch", "z": "yaw"}
_EARTH = {"x": "north", "y": "east", "z": "down"}
_FRD, _ROLL = "body axes: x forward, y right, z down", "body axes: x roll, y pitch, z yaw"
_NED = "x north, y east, z down"
KINDS = (
    Kind("acc_", "Specific force (accelerometer)", _FRD, "specific force", _BODY),
    Kind("gyro_rate_", "Angular acceleration", _ROLL, "angular acceleration", _TURN),
    Kind("gyro_", "Body rates", _ROLL, "body rate", _TURN),
    Kind("vel_", "Velocity", _NED, "velocity", _EARTH),
    Kind("pos_", "Position", _NED, "position", _EARTH),
    Kind("att_", "Attitude", "x roll, y pitch, z yaw", "attitude", _TURN),
    Kind("q_", "Attitude (quaternion)", "body to NED"),
    *(_of_sensor(s) for s in SENSORS if s.group != BODY),
    Kind("", "Other channels"),
)


def describe(channel: str) -> str:
    """A channel's name in words: `acc_z` is the specific force on the down axis."""
    name = channel.split("@")[0]
    kind = kind_of(name)
    axis = kind.axis.get(name.removeprefix(kind.prefix))
    return ", ".join(filter(None, (kind.words or name.replace("_", " "), axis)))


def kind_of(channel: str) -> Kind:
    """The quantity that a channel is of."""
    return next(kind for kind in KINDS if channel.startswith(kind.prefix))


def grouped(channels: Sequence[Channel]) -> list[tuple[Kind, list[Channel]]]:
    """Channels that share a figure: same quantity, same horizon; in the order of `KINDS`."""
    found: dict[tuple[int, float], list[Channel]] = {}
    for channel in channels:
        place = KINDS.index(kind_of(channel.name)), channel.horizon_s
        found.setdefault(place, []).append(channel)
    return [(KINDS[i], found[i, horizon_s]) for i, horizon_s in sorted(found)]


def mode(horizon_s: float) -> str:
    """How the twin was held against the flight, in words; 0: at each instant."""
    return "teacher-forced" if horizon_s == 0 else f"short horizon, {horizon_s:g} s"
