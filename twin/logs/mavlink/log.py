"""MAVLink telemetry log -> Flight."""

from array import array
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...errors import LogError
from ..airframe import NO_MULTIROTOR, Airframe, SourcedValue
from ..assemble import FlightBuilder, phases_of_table
from ..autopilot import Span, ground_spans
from ..flight import Array, Finding, FindingCollector, Flight
from ..formats import ReadOptions
from ..stamps import monotonic_samples
from ..validate import validate
from .decoder import LANDED, USED, MavlinkDecoder, Sample, Sources, Stamp, columns_of
from .frames import PHASES, Frame, LinkCounts, MessageParser, dialect, frames

_SHOWN = 8
"""Number of kinds of message that an error lists."""


class _Samples:
    """Samples of one system by signal, source and width, as arrays: 8 bytes a number.

    Attributes:
        sources: Selected source of each signal, after `by_group` was called.
    """

    def __init__(self) -> None:
        self.sources = Sources()
        self._columns: dict[tuple[str, str, int], tuple[array[int], array[float]]] = {}

    def __len__(self) -> int:
        return sum(len(t) for t, _ in self._columns.values())

    def add(self, samples: Iterable[Sample]) -> None:
        """Add samples in order of arrival."""
        for sample in samples:
            self.sources.add(sample)
            key = sample.group, sample.source, len(sample.values)
            if key not in self._columns:
                self._columns[key] = array("q"), array("d")
            times, values = self._columns[key]
            times.append(sample.t_us)
            values.extend(sample.values)

    def by_group(self) -> dict[str, tuple[NDArray[np.int64], Array]]:
        """Times, us, and values of each signal, from its best source, in order of arrival.

        Of several widths the one with the most samples is used: the aircraft may send its number of
        motors late.
        """
        found = {}
        self.sources.choose()
        for group, source in self.sources.chosen.items():
            widths = {
                w: len(t)
                for (g, s, w), (t, _) in self._columns.items()
                if (g, s) == (group, source)
            }
            width = max(widths, key=lambda w: widths[w])
            times, flat = self._columns[group, source, width]
            t_us = np.array(times, dtype=np.int64)
            values = np.array(flat, dtype=np.float64).reshape(-1, width)
            if _is_reordered(t_us):
                order = np.argsort(t_us, kind="stable")
                t_us, values = t_us[order], values[order]
            found[group] = t_us, values
        return found


@dataclass(slots=True)
class _Log(FindingCollector):
    """Findings of a log."""

    findings: list[Finding] = field(default_factory=list)


def read_tlog(path: Path, blob: bytes, options: ReadOptions) -> Flight:
    """Read a telemetry log of a ground station, or `raw.tlog` of `uavtwin live`.

    Of several systems the multirotor with the most samples is read, without one the system with the
    most. Arguments and errors as in `formats.Reader`.
    """
    log, link = _Log(), LinkCounts()
    system, decoder, samples = _aircraft(path, log, link, blob)
    by_group = samples.by_group()
    if not by_group:
        raise LogError(
            f"{path.name}: of {link.of(system).received} messages of system {system} none holds a "
            f"signal that is read; there are {_listed(decoder.kinds)}.{_is_other(decoder)} Ask for "
            "HIGHRES_IMU, "
            f"ODOMETRY and ACTUATOR_OUTPUT_STATUS (SET_MESSAGE_INTERVAL) and fly again."
        )
    start_us = min(int(t[0]) for t, _ in by_group.values())
    facts = {"aircraft": f"MAVLink system {system}", "autopilot": decoder.autopilot or "unknown"}
    flight = FlightBuilder(log, path, facts)
    for group, (t_us, values) in by_group.items():
        if group != LANDED:
            columns = columns_of(group, values.shape[1])
            keep = monotonic_samples(log, group, t_us, "samples", "warning")
            flight.add(group, columns, t_us[keep] - start_us, values[keep])
    advice = "Ask for HIGHRES_IMU and ODOMETRY (SET_MESSAGE_INTERVAL) and fly again."
    table = flight.lay_out(advice, ": the aircraft restarted?")
    begin_us = start_us + int(flight.t_us[0])
    table["time"] = (flight.t_us - flight.t_us[0]) * 1e-6
    landed = by_group.get(LANDED)
    phases = [] if landed is None else _phases(table, landed[0] - begin_us, landed[1])
    flight.facts |= {f"source {g}": s for g, s in samples.sources.chosen.items()}
    _note(log, decoder, link, system, table)
    found = flight.flight(table, phases, airframe=_airframe(decoder))
    mended, doubts = validate(path.name, found.columns)
    return replace(found, table=found.table.assign(**mended), findings=(*log.findings, *doubts))


def _aircraft(
    path: Path, log: _Log, link: LinkCounts, blob: bytes
) -> tuple[int, MavlinkDecoder, _Samples]:
    """The multirotor with the most samples, else the system with the most: its id, its decoder, and
    its samples in order of arrival."""
    decoders: defaultdict[int, MavlinkDecoder] = defaultdict(MavlinkDecoder)
    samples: defaultdict[int, _Samples] = defaultdict(_Samples)
    astray: Counter[int] = Counter()
    parser, lost = MessageParser(link), 0
    for frame in frames(blob):
        if not isinstance(frame, Frame):
            lost += frame
            continue
        if frame.kind not in USED:
            link.add(frame.system, frame.component, frame.number, frame.checksum)
            continue
        for message, _ in parser.push(frame.content):
            decoder = decoders[frame.system]
            found = decoder.samples(message)
            if decoder.stamp is Stamp.MISLED:
                astray[frame.system] += len(samples[frame.system])
                samples[frame.system] = _Samples()
            samples[frame.system].add(found)
    log.note("error", "file", "bytes that are no stamped MAVLink frame", lost)
    log.note("error", "file", "frames whose checksum is wrong", parser.wrong)
    log.note("info", "file", "messages that came twice, left out", parser.repeated)
    if not link.sequences:
        raise LogError(f"{path.name}: no whole MAVLink frame in {len(blob)} bytes. Copy it again.")
    heard = {s: link.of(s).received for s in link.systems}
    system = max(heard, key=lambda s: (not _other(decoders[s]), len(samples[s]), heard[s]))
    others = sorted((len(samples[s]), s) for s in samples if samples[s] and s != system)[::-1]
    for count, other in others[:_SHOWN]:
        message = f"another aircraft, system {other}, left out; system {system} is read"
        log.note("warning", "aircraft", message, count)
    more = others[_SHOWN:]
    message = f"samples of {len(more)} further systems left out; system {system} is read"
    log.note("warning", "aircraft", message, sum(count for count, _ in more))
    message = "messages left out, their time is far from the aircraft's clock"
    log.note("warning", "time", message, decoders[system].strays + astray[system])
    return system, decoders[system], samples[system]


def _other(decoder: MavlinkDecoder) -> str:
    """Type of a system that is no multirotor, by its heartbeat; "" where it may be one."""
    kind = decoder.type
    return f"MAV_TYPE is {kind}, {NO_MULTIROTOR[kind]}" if kind in NO_MULTIROTOR else ""


def _is_other(decoder: MavlinkDecoder) -> str:
    """Sentence on a system that is no multirotor."""
    return f" It is none: {_other(decoder)}." if _other(decoder) else ""


def _airframe(decoder: MavlinkDecoder) -> Airframe:
    """Facts of the aircraft in the heartbeat."""
    motors = decoder.motors
    source = f"MAV_TYPE {decoder.type} of the heartbeat"
    rotors = None if motors is None else SourcedValue(motors, source)
    return Airframe(no_multirotor=_other(decoder), rotors=rotors)


def _is_reordered(t_us: NDArray[np.int64]) -> bool:
    """Whether times run backward by less than a second: reordered messages."""
    back = np.diff(t_us)
    return bool((back < 0).any() and back.min() > -1_000_000)


def _phases(table: pd.DataFrame, t_us: NDArray[np.int64], state: Array) -> list[Span]:
    """Phases by the land detector, those in the air by the motion of the aircraft."""
    t_s = np.asarray(t_us * 1e-6, dtype=np.float64)
    ground = ground_spans(t_s, state[:, 0] == dialect.MAV_LANDED_STATE_ON_GROUND)
    ground = phases_of_table(table, ground)
    edges = np.append(t_s, np.inf)
    for k, code in enumerate(state[:, 0].tolist()):
        if (name := PHASES.get(code, "ground")) != "ground":
            ground.append((name, float(edges[k]), float(edges[k + 1])))
    return ground


def _note(
    log: _Log, decoder: MavlinkDecoder, link: LinkCounts, system: int, table: pd.DataFrame
) -> None:
    """Findings on lost and dropped data."""
    total = link.of(system)
    if total.lost:
        share = 100 * total.lost / (total.lost + total.received)
        log.note("warning", "link", f"messages lost on the way, {share:.2g} % of all", total.lost)
    for (group, why), count in sorted(decoder.dropped.items()):
        log.note("error", group, f"samples left out: {why}", count)
    if decoder.motors is None and decoder.kinds["ACTUATOR_OUTPUT_STATUS"]:
        log.note("warning", "cmd", "no heartbeat says how many motors there are; left out")
    if "cmd_1" in table and decoder.kinds["SERVO_OUTPUT_RAW"] and not decoder.motor_outputs:
        message = "no SERVOn_FUNCTION and no PWM_MAIN_FUNCn was sent: output k taken for motor k"
        log.note("warning", "cmd", message)
    if "cmd_1" in table and not any(
        n.endswith(("PWM_MIN", "MAIN_MIN")) for n in decoder.parameters
    ):
        low, high = decoder.pulses_us
        message = f"pulses, where there are some, count as 0..1 from {low:g} to {high:g} us"
        log.note("info", "cmd", f"{message}: no parameter was sent that says so")


def _listed(kinds: Counter[str]) -> str:
    names = [name for name, _ in kinds.most_common(_SHOWN)]
    return ", ".join(names) or "none"
