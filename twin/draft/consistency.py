"""Comparison of the rotors of a vehicle file with those stated in a log.

A log states number, order, positions and directions of the rotors (`CA_ROTOR*` and `SYS_AUTOSTART`
of PX4, `FRAME_CLASS` and `FRAME_TYPE` of ArduPilot, the mixer of Betaflight, the notes of a flight
table). A vehicle file that contradicts them makes every comparison wrong, and the residuals
resemble a physical effect. Sizes are compared only where the log has metres: autopilots need
proportions only. Where the flight clearly turned by the layout of the vehicle file and not by that
of its log, the parameters of the log are not those of the aircraft, which is a warning.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from ..errors import ModelError
from ..logs import AnyFlight, Flight
from ..logs.agreement import signals
from ..logs.flight import once_per_flight
from ..logs.motor_checks import doubt_moments
from ..vehicle import Vehicle
from ..vehicle.layouts import CW, Layout

Array = NDArray[np.float64]
NEAR = 0.4
"""Tolerance of a hub's position against the log, over the distance to the next rotor. Frames with
the same number of rotors, turned by half a pitch, differ by 0.51 to 0.54."""
SAME_SIZE = 1.3
"""Ratio of sizes in metres from which it is reported; by judgement, as `SAME_CELLS`."""
SAME_CELLS = 1.15
"""Ratio of battery voltages from which it is reported: 4 cells over 3 are 1.33, 7 over 6 are
1.17."""
SAME_CUTOFF = 1.5
"""Ratio of cut-off frequencies of a filter from which it is reported; by judgement."""
_LONGEST_S = 120.0
"""Part of a long flight that is read to find how it turned, s."""
OVERRIDE = "--trust-vehicle"  # option by which the vehicle file overrides the log


class _Differences(NamedTuple):
    """Differences of two layouts with the same number of rotors.

    Attributes:
        direction: Sentence on directions of rotation; "": they agree.
        position: Sentence on order or positions; "": they agree.
    """

    direction: str = ""
    position: str = ""

    def __bool__(self) -> bool:
        return bool(self.direction or self.position)


@dataclass(frozen=True, slots=True)
class Consistency:
    """Contradictions between a vehicle file and a log of one aircraft.

    Attributes:
        error: Reason why they cannot be compared; "": they can.
        warnings: Warnings on the comparison.
    """

    error: str = ""
    warnings: tuple[str, ...] = ()


def check_airframe(flight: AnyFlight, vehicle: Vehicle) -> None:
    """Refuse a vehicle whose rotors differ from those of the log.

    Raises:
        ModelError: Number, order, positions or directions differ; the text names both sources.
    """
    if error := consistency(flight, vehicle).error:
        raise ModelError(error)


@once_per_flight
def consistency(flight: AnyFlight, vehicle: Vehicle) -> Consistency:
    """Compare a vehicle with the facts of the aircraft in a flight's log; where the log has none of
    its rotors, with how the flight turned."""
    airframe, file = flight.airframe, vehicle.file or vehicle.name
    if airframe is None or airframe.layout is None or not airframe.layout.places_known:
        turned = _turned_otherwise(flight, vehicle, file)
    else:
        turned = []
    if airframe is None:
        return Consistency(warnings=tuple(turned))
    warnings = [*turned, *_sizes(flight, vehicle, file), *_cells(flight, vehicle, file)]
    warnings += _cutoffs(flight, vehicle, file)
    layout, count = airframe.layout, vehicle.rotors.count
    driven = flight.has(f"cmd_{count}") and not flight.has(f"cmd_{count + 1}")
    if layout is None or layout.count != count:
        reported = (layout.count, layout.source) if layout is not None else airframe.rotors
        if reported is None or reported[0] == count or driven:
            return Consistency(warnings=tuple(warnings))
        why = (
            f"rotors.position of {file} has {count} rotors, the log has {reported[0]} "
            f"({reported[1]})"
        )
        return Consistency(_refusal(flight, (why,)), tuple(warnings))
    found = _differences(layout, vehicle, file) if layout.places_known else _Differences()
    if not found:
        return Consistency(warnings=tuple(warnings))
    if by_flight := _as_the_vehicle(flight, layout, vehicle, file):
        said = "; ".join(filter(None, found))
        warnings.insert(0, f"{said}. {by_flight}. The vehicle file is taken")
        return Consistency(warnings=tuple(warnings))
    return Consistency(_refusal(flight, tuple(filter(None, found))), tuple(warnings))


def _refusal(flight: AnyFlight, whys: tuple[str, ...]) -> str:
    log = flight.name if flight.source is None else flight.source.name
    return (
        f"{log}: the vehicle file contradicts the log: {'; '.join(whys)}. Correct the "
        f"vehicle file (uavtwin vehicle draft writes what the log says), choose that of this "
        f"aircraft, or, where the log's own parameters are wrong, give {OVERRIDE}."
    )


# -- rotors -----------------------------------------------------------------------------------


def _differences(layout: Layout, vehicle: Vehicle, file: str) -> _Differences:
    """Differences in positions and directions between equal numbers of rotors."""
    rotors = vehicle.rotors
    log, own = _proportions(layout.position), _proportions(rotors.position_m)
    if log is None or own is None:
        return _Differences(_senses(layout, rotors.direction, file))
    near = NEAR * _spacing(log)
    apart = np.linalg.norm(log[:, None] - own[None], axis=2)  # rows: rotors of the log
    if np.all(np.diag(apart) <= near):
        return _Differences(_senses(layout, rotors.direction, file))
    order = _order(apart, layout, rotors.direction)
    if np.all(apart[np.arange(len(order)), order] <= near):
        position = _other_order(order, layout, rotors.position_m, file)
        direction = ""
        if not _alike(layout, rotors.direction) and not _alike(layout, rotors.direction[order]):
            direction = _senses(layout, rotors.direction, file)
        return _Differences(direction, position)
    return _Differences(
        _senses(layout, rotors.direction, file), _other_places(log, own, near, layout, file)
    )


def _proportions(position: Array) -> Array | None:
    """Hubs in the rotor plane relative to their mean, with mean square distance 1, shape (n, 2);
    None: all are at one point."""
    plane = position[:, :2] - position[:, :2].mean(axis=0)
    size = float(np.sqrt(np.mean(np.sum(plane * plane, axis=1))))
    return plane / size if size > 0.0 else None


def _spacing(plane: Array) -> Array:
    """Distance of each hub to the nearest one that is not above or below it, shape (n,)."""
    apart = np.linalg.norm(plane[:, None] - plane[None], axis=2)
    return np.asarray(np.where(apart < 0.1, np.inf, apart).min(axis=1))


def _order(apart: Array, layout: Layout, direction: Array) -> NDArray[np.intp]:
    """Row of the vehicle file that is nearest to each motor of the log; of two coaxial rotors the
    one with the same direction."""
    turned = (layout.direction[:, None] != direction[None]) * 1e-3
    return np.asarray(scipy.optimize.linear_sum_assignment(apart**2 + turned)[1], dtype=np.intp)


def _alike(layout: Layout, direction: Array) -> bool:
    return not layout.senses_known or bool(np.array_equal(layout.direction, direction))


def _senses(layout: Layout, direction: Array, file: str) -> str:
    """Sentence on directions of rotation that differ; "" where none does or the log does not have
    them."""
    if _alike(layout, direction):
        return ""
    wrong = np.flatnonzero(layout.direction != direction)
    first = int(wrong[0])
    others = ", ".join(str(k + 1) for k in wrong[1:])
    text = (
        f"rotors.direction of {file} says {_sense(direction[first])} for rotor {first + 1} "
        f"({_place(layout.position[first])}), {layout.sense_key(first)} says "
        f"{_sense(layout.direction[first])}"
    )
    if len(wrong) == layout.count:
        return f"{text}; the others are turned as well"
    return f"{text}; likewise rotor{'s' * (len(wrong) > 2)} {others}" if others else text


def _other_order(order: NDArray[np.intp], layout: Layout, position: Array, file: str) -> str:
    moved = np.flatnonzero(order != np.arange(len(order)))
    first = int(moved[0])
    rows = ", ".join(str(k + 1) for k in order)
    return (
        f"the rows of rotors.position of {file} are in another order, or mirrored: row "
        f"{first + 1} is {_place(position[first])}, {layout.place_key(first)} has motor "
        f"{first + 1} {_place(layout.position[first])}; motors 1 to {len(order)} of the log are "
        f"its rows {rows}"
    )


def _other_places(log: Array, own: Array, near: Array, layout: Layout, file: str) -> str:
    worst = int(np.argmax(np.linalg.norm(log - own, axis=1) / near))
    return (
        f"rotors.position of {file} has rotor {worst + 1} at {_bearing(own[worst])} from ahead, "
        f"{layout.place_key(worst)} at {_bearing(log[worst])}"
    )


def _sense(direction: float) -> str:
    return "cw" if direction == CW else "ccw"


def _place(position: Array) -> str:
    """Position of a hub in words."""
    x, y = float(position[0]), float(position[1])
    size = np.hypot(x, y)
    ahead = "front" if x > 0.2 * size else "rear" if x < -0.2 * size else ""
    side = "right" if y > 0.2 * size else "left" if y < -0.2 * size else ""
    return f"{ahead} {side}".strip() or "in the middle"


def _bearing(plane: Array) -> str:
    """Angle from the nose to the right, degrees."""
    return f"{np.degrees(np.arctan2(plane[1], plane[0])):+.0f} deg"


def _turned_otherwise(flight: AnyFlight, vehicle: Vehicle, file: str) -> list[str]:
    """Warnings that the flight did not turn as the commands to the rotors of the file predict; none
    where motion or commands are not informative."""
    rotors = vehicle.rotors
    return _contradicted(flight, Layout(rotors.position_m, rotors.direction, True, 0.0, file))


def _contradicted(flight: AnyFlight, layout: Layout) -> list[str]:
    """Contradictions between the angular acceleration of a flight and the rotors of a layout."""
    part = _beginning(flight)
    there = signals(part.columns)
    if len(there.get("cmd", ())) != layout.count:
        return []
    return [f.message for f in doubt_moments(part.columns, there, layout)]


def _beginning(flight: AnyFlight) -> Flight:
    """The first part of a flight stored in its file; a flight in memory unchanged."""
    begin_s = float(flight.time_s[0])
    return flight if isinstance(flight, Flight) else flight.between(begin_s, begin_s + _LONGEST_S)


def _as_the_vehicle(flight: AnyFlight, layout: Layout, vehicle: Vehicle, file: str) -> str:
    """Clause that the flight turned by the layout of the vehicle file and not by that of its log;
    else ""."""
    by_log = _contradicted(flight, layout)
    if not by_log or _turned_otherwise(flight, vehicle, file):
        return ""
    return f"The flight turned as the vehicle file says, not as its log does: {by_log[0]}"


# -- what makes no comparison impossible ------------------------------------------------------


def _sizes(flight: AnyFlight, vehicle: Vehicle, file: str) -> Iterator[str]:
    assert flight.airframe is not None
    layout = flight.airframe.layout
    if layout is None or not layout.metric or layout.count != vehicle.rotors.count:
        return
    reported, own = layout.arm, vehicle.arm_m
    if not 1 / SAME_SIZE < own / reported < SAME_SIZE:
        yield (
            f"the arm is {own:.3g} m by rotors.position of {file}, {reported:.3g} m by "
            f"{layout.source}"
        )


def _cells(flight: AnyFlight, vehicle: Vehicle, file: str) -> Iterator[str]:
    assert flight.airframe is not None
    reported, battery, key = flight.airframe.cells, vehicle.battery, "battery.full_voltage"
    if reported is None:
        return
    low_v, high_v = (
        reported.value.count * v for v in (reported.value.empty_v, reported.value.full_v)
    )
    if (
        battery is not None
        and not high_v / SAME_CELLS < battery.full_voltage_v < high_v * SAME_CELLS
    ):
        yield (
            f"{key} of {file} is {battery.full_voltage_v:.3g} V, the log has "
            f"{reported.value.count} cells, {high_v:.3g} V when full ({reported.source})"
        )
    reference_v = vehicle.rotors.reference_voltage_v
    if reference_v is not None and not low_v / SAME_CELLS < reference_v < high_v * SAME_CELLS:
        yield (
            f"rotors.reference_voltage of {file} is {reference_v:.3g} V, the log has "
            f"{reported.value.count} cells, {low_v:.3g} to {high_v:.3g} V ({reported.source})"
        )


def _cutoffs(flight: AnyFlight, vehicle: Vehicle, file: str) -> Iterator[str]:
    assert flight.airframe is not None
    for name, reported, own in (
        ("accel", flight.airframe.accel_cutoff_hz, vehicle.accel_cutoff_hz),
        ("gyro", flight.airframe.gyro_cutoff_hz, vehicle.gyro_cutoff_hz),
    ):
        if reported is None or own is None or 1 / SAME_CUTOFF < own / reported.value < SAME_CUTOFF:
            continue
        yield (
            f"imu.{name}_cutoff of {file} is {own:g} Hz, {reported.source} is {reported.value:g} Hz"
        )
