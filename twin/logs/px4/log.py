"""PX4 ULog files opened with care: what can be read is read, what cannot is counted."""

import contextlib
import io
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog

from ...errors import LogError
from ..clock import advancing
from ..flight import Array, Finding

_FIRST_DATA = b"AL"  # the first of these ends the definitions
_LONGEST = 10000  # bytes of a message; longer ones are damage
_MESSAGES = b"BFIMPQADLCSOR"
_EVENTS = ("vehicle_command",)  # several may carry the same time
TOPICS = (
    "actuator_armed",
    "actuator_controls_0",
    "actuator_motors",
    "actuator_outputs",
    "battery_status",
    "esc_status",
    "estimator_sensor_bias",
    "multirotor_motor_limits",
    "rate_ctrl_status",
    "sensor_combined",
    "sensor_gps",
    "vehicle_acceleration",
    "vehicle_air_data",
    "vehicle_angular_velocity",
    "vehicle_attitude",
    "vehicle_attitude_setpoint",
    "vehicle_command",
    "vehicle_gps_position",
    "vehicle_imu_status",
    "vehicle_land_detected",
    "vehicle_local_position",
    "vehicle_magnetometer",
    "vehicle_mocap_odometry",
    "vehicle_rates_setpoint",
    "vehicle_visual_odometry",
)

NEEDED = ("sensor_combined", "vehicle_attitude", "vehicle_local_position", "actuator_outputs")
"""Some of them, for an error."""


@dataclass(frozen=True, slots=True)
class Topic:
    """Samples of one topic instance, in order of time.

    Attributes:
        name: Topic name.
        t_us: Time of each sample since the start of the log, us, shape (n,): the time the
            sample was taken where the log has it, else the time it was published.
        data: Fields, each of shape (n,).
        by_sample_time: Whether `t_us` is the time of sampling.
    """

    name: str
    t_us: NDArray[np.int64]
    data: Mapping[str, NDArray[Any]]
    by_sample_time: bool

    @property
    def t_s(self) -> Array:
        """Times, s, shape (n,)."""
        return np.asarray(self.t_us * 1e-6, dtype=np.float64)

    @property
    def rate_hz(self) -> float:
        """Mean rate between the first and the last sample, 0 for fewer than two samples."""
        if len(self.t_us) < 2:
            return 0.0
        return float((len(self.t_us) - 1) / ((self.t_us[-1] - self.t_us[0]) * 1e-6))

    def has(self, *fields: str) -> bool:
        """Whether every field is there."""
        return all(f in self.data for f in fields)

    def columns(self, fields: Sequence[str]) -> Array:
        """Fields side by side, shape (n, len(fields))."""
        with np.errstate(invalid="ignore"):  # damaged logs hold signalling NaN
            return np.column_stack([self.data[f].astype(np.float64) for f in fields])

    def array(self, stem: str, n: int) -> Array:
        """Array field `stem[0..n-1]`, shape (n_samples, n)."""
        return self.columns([f"{stem}[{i}]" for i in range(n)])

    def at(self, t_us: NDArray[np.int64], name: str) -> Array:
        """Value of a field held from its last sample, the first one before that."""
        index = np.searchsorted(self.t_us, t_us, side="right") - 1
        with np.errstate(invalid="ignore"):
            return self.data[name].astype(np.float64)[np.maximum(index, 0)]


@dataclass(slots=True)
class Px4Log:
    """One ULog on its own clock.

    Attributes:
        path: File.
        start_us: Time of the log's start on the flight controller's clock, us.
        params: Parameters with the changes made during the flight applied.
        changed: Parameters changed after the start of the log.
        info: What the log says about firmware and hardware.
        findings: Grows while the log is read.
    """

    path: Path
    start_us: int
    params: dict[str, float]
    changed: frozenset[str]
    info: dict[str, str]
    findings: list[Finding] = field(default_factory=list)
    _raw: dict[tuple[str, int], Mapping[str, NDArray[Any]]] = field(default_factory=dict)
    _topics: dict[tuple[str, int], Topic | None] = field(default_factory=dict)

    def note(self, severity: str, where: str, message: str, count: int = 1) -> None:
        """Add a finding."""
        self.findings.append(Finding(severity, where, message, count))  # type: ignore[arg-type]

    def instances(self, name: str) -> list[int]:
        """Instances of a topic that hold samples."""
        return sorted(k for n, k in self._raw if n == name)

    def fields(self, name: str) -> Mapping[str, NDArray[Any]]:
        """What the first instance of a topic holds, in the order of the file; {} without it."""
        return self._raw.get((name, 0), {})

    def topic(self, name: str, instance: int = 0, *needs: str) -> Topic | None:
        """A topic with its samples in order, None where the log has none with these fields."""
        key = (name, instance)
        if key not in self._topics:
            self._topics[key] = self._ordered(name, instance)
        topic = self._topics[key]
        if topic is not None and not topic.has(*needs):
            lacks = [f for f in needs if not topic.has(f)]
            self.note("warning", name, f"has no field {', '.join(lacks)}; the topic is not used")
            return None
        return topic

    def _ordered(self, name: str, instance: int) -> Topic | None:
        raw = self._raw.get((name, instance))
        if raw is None:
            return None
        published = _from_px4_us(raw["timestamp"], self.start_us)
        t_us, by_sample = published, False
        if "timestamp_sample" in raw:
            sampled = _from_px4_us(raw["timestamp_sample"], self.start_us)
            valid = (raw["timestamp_sample"] != 0) & (np.abs(sampled - published) < 1_000_000)
            by_sample = bool(valid.mean() > 0.5)
            t_us = np.where(valid, sampled, published) if by_sample else published
            if by_sample and not valid.all():
                lacking = int(np.count_nonzero(~valid))
                self.note(
                    "warning",
                    name,
                    "samples without a sampling time: published time taken",
                    lacking,
                )
        if name in _EVENTS:
            order = np.argsort(t_us, kind="stable")
            return Topic(name, t_us[order], {k: v[order] for k, v in raw.items()}, by_sample)
        keep, backward, repeated, jumped = advancing(t_us)
        for count, what in (
            (backward, "samples dropped whose time runs backward"),
            (repeated, "samples dropped whose time repeats"),
            (jumped, "samples dropped that lie more than a minute from the rest"),
        ):
            if count:
                self.note("error", name, what, count)
        if not keep.any():
            return None
        data = {k: v[keep] for k, v in raw.items()}
        return Topic(name, t_us[keep], data, by_sample)


def _from_px4_us(stamps: NDArray[Any], start_us: int) -> NDArray[np.int64]:
    """PX4 time stamps (us since boot, unsigned) -> us since the start of the log."""
    return np.asarray(stamps.astype(np.int64) - start_us, dtype=np.int64)


def _finite(value: object) -> bool:
    """Whether a parameter has a usable value; damaged logs have text or NaN."""
    return isinstance(value, int | float) and bool(np.isfinite(value))


def _messages(blob: bytes) -> tuple[int, int]:
    """Walk the message headers; bytes of a message cut off at the end, bytes never understood."""
    at, end = 16, len(blob)
    header = struct.Struct("<HB").unpack_from
    while at + 3 <= end:
        size, kind = header(blob, at)
        if kind not in _MESSAGES:
            return 0, end - at
        if at + 3 + size > end:
            break
        at += 3 + size
    return end - at, 0


def _check_definitions(path: Path, blob: bytes) -> None:
    """Refuse a log whose definitions are cut or damaged; pyulog 1.3 never returns from some."""
    at, end = 16, len(blob)
    header = struct.Struct("<HB").unpack_from
    while at + 3 <= end:
        size, kind = header(blob, at)
        if kind in _FIRST_DATA:
            return
        if kind == 0 or not 0 < size <= _LONGEST:
            raise LogError(
                f"{path.name}: damaged ULog: byte {at} of {end}, within its definitions, makes no "
                "sense. Copy the log from the vehicle again."
            )
        at += 3 + size
    raise LogError(
        f"{path.name}: ULog cut short within its definitions after {end} bytes, before any "
        "sample. Copy the log from the vehicle again."
    )


def open_px4(path: Path, blob: bytes) -> Px4Log:
    """Parse a ULog.

    Args:
        path: File name, for messages.
        blob: Content of the file.

    Raises:
        LogError: Nothing in it can be used.
    """
    _check_definitions(path, blob)
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):
            log = ULog(io.BytesIO(blob), list(TOPICS))
    except Exception as error:  # pyulog raises many kinds on damaged files
        raise LogError(
            f"{path.name}: damaged ULog, {len(blob)} bytes: its definitions cannot be read "
            f"({type(error).__name__}: {error}). Copy the log from the vehicle again."
        ) from error
    raw = {
        (d.name, int(d.multi_id)): d.data
        for d in log.data_list
        if len(d.data.get("timestamp", ())) > 0
    }
    if not raw:
        raise LogError(
            f"{path.name}: ULog of {len(blob)} bytes without any sample of "
            f"{', '.join(NEEDED)} or the like. The log was cut inside its header, or "
            "logging never started: copy the log again, or set SDLOG_MODE and fly again."
        )
    start = int(log.start_timestamp)
    params = {k: float(v) for k, v in log.initial_parameters.items() if _finite(v)}
    changes = [c for c in log.changed_parameters if _finite(c[2])]
    params.update({c[1]: float(c[2]) for c in changes})
    opened = Px4Log(
        path,
        start,
        params,
        frozenset(c[1] for c in changes if c[0] > start),
        {k: str(v) for k, v in log.msg_info_dict.items()},
        _raw=raw,
    )
    _note_damage(opened, blob, log)
    return opened


def _note_damage(opened: Px4Log, blob: bytes, log: Any) -> None:
    """Findings on a log cut short, damaged, or with drop-outs."""
    tail, lost = _messages(blob)
    if lost or log.file_corruption:
        opened.note(
            "error",
            "log",
            f"damaged: {lost} of {len(blob)} bytes follow the first message that makes no "
            "sense; the messages found after it are used, the rest is lost",
            max(lost, 1),
        )
    elif tail:
        opened.note(
            "error",
            "log",
            f"cut short: it ends inside a message, the last {tail} bytes are not used",
            tail,
        )
    if log.dropouts:
        lost_ms = sum(d.duration for d in log.dropouts)
        opened.note(
            "warning",
            "log",
            f"drop-outs while logging, {lost_ms} ms together, the longest "
            f"{max(d.duration for d in log.dropouts)} ms; use a faster card or log less",
            len(log.dropouts),
        )
