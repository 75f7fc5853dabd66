"""Mass, inertia and the places of the rotors, for a draft."""

import numpy as np

from ..errors import ModelError
from ..vehicle.layouts import FRAMES, Layout, frame, frames_of
from . import scaling
from .making import Making, percent, rounded
from .turning import CLEAR, best_frame, turning

_MASS_SD = 0.01
"""Weighed, as `twin.vehicle.deviation.WORDS` has it."""
_ARM_SD = 0.03
"""Measured with a ruler, as there."""
_SIZES_APART = 0.1


def draft_body(m: Making) -> Layout:
    """Add mass, rotors' places and senses, inertia; returns the rotors.

    Raises:
        ModelError: Arrangement or size of the rotors is not known.
    """
    mass = m.known.mass_kg
    m.file.number("body.mass", mass, "kg", "given, as weighed", percent(_MASS_SD))
    m.say("mass", f"{mass:.4g} kg, sd {percent(_MASS_SD)}", "given, as weighed")
    layout = _sized(m, _layout(m))
    sd = float(np.hypot(layout.sd, _ARM_SD))
    position = np.round(layout.position, 5)
    m.file.number("rotors.position", position, "m", layout.source, percent(sd))
    turns = ["cw" if d > 0 else "ccw" for d in layout.direction]
    m.file.words("rotors.direction", list(turns), layout.source)
    m.say("rotors", f"{layout.count}: {' '.join(turns)}; arm {layout.arm:.4g} m", layout.source)
    inertia, sd = scaling.inertia(mass, layout.arm)
    source = (
        "estimate: mass and arm times the usual radii of gyration, geometric mean of "
        f"{len(scaling.BODIES)} published quadrotors"
    )
    values = np.array([rounded(x) for x in inertia])
    m.file.number("body.inertia", values, "kg*m^2", source, percent(sd))
    each = ", ".join(f"{x:.3g}" for x in values)
    value = f"{each} kg m2, sd {percent(sd)}"
    m.say("inertia", value, "estimate: radii of gyration as of published quadrotors")
    return layout


def _layout(m: Making) -> Layout:
    """Order and sense of the rotors: as given, as the log says, else as it turned."""
    motors, by_log = m.hovers[0].motors, m.airframe.layout
    if m.known.frame is not None:
        name = _frame_name(m.known.frame, motors)
        layout = frame(name, f"given, frame {name}")
    elif by_log is not None and by_log.count == motors:
        layout = by_log
    else:
        return _as_it_turned(m, motors)
    for flight in m.flights:
        turned = turning(flight, layout)
        if turned is not None and min(turned.worst, turned.yaw) < -CLEAR:
            better = best_frame(flight, motors)
            hint = f" It turns like frame {better[0]!r} ({better[1]})." if better else ""
            m.warnings.append(
                f"{flight.name}: its commands turn it otherwise than these rotors would "
                f"({layout.source}): moment and angular acceleration correlate by {turned}.{hint}"
            )
    return layout


def _as_it_turned(m: Making, motors: int) -> Layout:
    """The frame by which a flight's commands explain best how it turned."""
    found = best_frame(m.flights[0], motors)
    if found is None:
        raise ModelError(
            f"{m.flights[0].name}: the log does not say where its {motors} rotors are and how they "
            f"turn. Give the frame (--frame), one of: {', '.join(frames_of(motors)) or 'none'}."
        )
    name, turned = found
    return frame(
        name, f"frame {name}: of those with {motors} rotors it turns like this one ({turned})"
    )


def _frame_name(given: str, motors: int) -> str:
    """A frame as people call it: `x` of six rotors is `hex x`."""
    name = " ".join(given.lower().replace("-", " ").replace("_", " ").split())
    for full in (name, name.removeprefix("quad "), f"hex {name}", f"octo {name}"):
        if full in FRAMES and len(FRAMES[full][0]) == motors:
            return full
    known = ", ".join(frames_of(motors)) or "none; the log must tell it (CA_ROTOR* of PX4)"
    raise ModelError(f"frame {given!r} is none with {motors} rotors. Those are: {known}.")


def _sized(m: Making, layout: Layout) -> Layout:
    """The layout in metres."""
    arm = m.known.arm_m
    if arm is None and not layout.metric:
        raise ModelError(
            f"{m.flights[0].name}: how its rotors are arranged is known ({layout.source}), how far "
            "apart they are is not. Give the distance of two motors across (--wheelbase 480mm) or "
            "from the centre to a motor (--arm 240mm)."
        )
    if arm is None:
        return layout
    if layout.metric and abs(layout.arm / arm - 1.0) > _SIZES_APART:
        m.warnings.append(
            f"arm {arm:g} m given, {layout.arm:.3g} m by {layout.source}: that given is taken"
        )
    return layout.sized(arm, f"arm {arm:.4g} m given")
