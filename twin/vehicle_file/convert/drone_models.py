"""Parameters of drone-models (`data/params.toml`, PyPI drone-models) as a vehicle file.

The numbers of its first-principles model are converted; `docs/reference/simulators.md` states the
law of each.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ModelError
from ...vehicle import Array
from ..write import Draft
from .common import FLU_TO_FRD, six_elements, turned

MARK = "rpm2thrust"
"""Key that every aircraft of such a file has."""
_SHAPES = {
    "mass": (),
    "L": (),
    "J": (3, 3),
    "gravity_vec": (3,),
    "rpm2thrust": (3,),
    "rpm2torque": (3,),
    "rotor_dyn_coef": (4,),
    "mixing_matrix": (3, 4),
    "drag_matrix": (3, 3),
    "prop_inertia": (),
    "thrust_min": (),
    "thrust_max": (),
}  # numbers that are read
_SOURCE = "drone-models, first-principles model"  # source of each number


def is_drone_models(tree: Mapping[str, Any]) -> bool:
    """Whether parsed TOML contains aircraft of drone-models."""
    return any(isinstance(t, dict) and MARK in t for t in tree.values())


def convert_drone_models(tree: Mapping[str, Any], path: Path, name: str | None) -> str:
    """Text of a vehicle file for one aircraft of a parsed `params.toml`.

    Raises:
        ModelError: No such aircraft, or a number is missing, has a wrong shape or has no law here.
    """
    aircraft = [n for n, t in tree.items() if isinstance(t, dict) and MARK in t]
    if name is None and len(aircraft) == 1:
        name = aircraft[0]
    if name not in aircraft:
        asked = "say which aircraft" if name is None else f"there is no aircraft {name!r}"
        raise ModelError(f"{path.name}: {asked}; it holds: {', '.join(aircraft)}.")
    its = {key: _array(path.name, name, tree[name], key) for key in _SHAPES}
    mix, arm = its["mixing_matrix"], float(its["L"])
    if np.any(np.abs(mix) != 1):
        raise ModelError(f"{path.name}: {name}.mixing_matrix must hold 1 and -1 alone.")
    drag = its["drag_matrix"]
    if np.any(drag != np.diag(np.diag(drag))):
        raise ModelError(
            f"{path.name}: {name}.drag_matrix has elements off its diagonal; a vehicle file has "
            f"one number per body axis."
        )
    gravity = its["gravity_vec"]
    if np.any(gravity[:2]) or gravity[2] >= 0:
        raise ModelError(f"{path.name}: {name}.gravity_vec = {gravity.tolist()} must point down z.")

    d = Draft(name, f"{name} of {_SOURCE}", path.name)
    unused = sorted(set(tree[name]) - set(_SHAPES))
    d.notes.append(
        f"Converted from {path.name} of drone-models, aircraft {name}: what its first-principles "
        f"model uses. It does not use, so it is left out: {', '.join(unused) or 'nothing'}."
    )
    d.notes.append(
        "Differences of law: its gyroscopic torque has the wrong sign about the roll axis, its "
        "drag knows no wind, and its thrust is negative where rpm2thrust is, here zero. Legs are "
        "not in the file."
    )
    d.number("body.mass", its["mass"], "kg", "mass")
    d.number("body.inertia", six_elements(turned(its["J"])), "kg*m^2", "J, turned to FRD")
    d.number("body.drag_linear", -np.diag(drag), "N*s/m", "drag_matrix, its diagonal negated")
    left = np.stack([-mix[1], mix[0], np.zeros(mix.shape[1])], axis=1)
    d.number(
        "rotors.position",
        arm * left * FLU_TO_FRD + 0.0,  # avoids negative zeros
        "m",
        "L times mixing_matrix (L is along each axis), turned to FRD",
    )
    d.words(
        "rotors.direction",
        ["cw" if yaw > 0 else "ccw" for yaw in mix[2]],
        "mixing_matrix, last row: torque on the body, up",
    )
    d.polynomial("rotors.thrust_from_speed", its["rpm2thrust"], "N", "rpm2thrust", of="rpm")
    d.polynomial("rotors.torque_from_speed", its["rpm2torque"], "N*m", "rpm2torque", of="rpm")
    low, high = (_rpm(path.name, name, its, key) for key in ("thrust_min", "thrust_max"))
    d.words("rotors.command_range", [low, high], "rpm of thrust_min and thrust_max by rpm2thrust")
    d.polynomial(
        "rotors.speed_from_command", np.array([0.0, 1.0]), "rpm", "its command is the speed in rpm"
    )
    rates = its["rotor_dyn_coef"]
    for key, ab, which in (("up", rates[:2], "first"), ("down", rates[2:], "last")):
        source = f"rotor_dyn_coef, {which} two"
        d.polynomial(f"rotors.rate_{key}", ab, "1/s", source, of="rpm")
    for key in ("spin_inertia", "reaction_inertia"):
        d.number(f"rotors.{key}", its["prop_inertia"], "kg*m^2", "prop_inertia")
    d.number("site.gravity", -gravity[2], "m/s^2", "gravity_vec")
    return d.text()


def _array(file: str, name: str, table: Mapping[str, Any], key: str) -> Array:
    if key not in table:
        raise ModelError(f"{file}: {name} has no {key}, which the first-principles model needs.")
    try:
        value = np.asarray(table[key], dtype=np.float64)
    except (TypeError, ValueError):
        value = np.full(0, np.nan)
    if value.shape != _SHAPES[key] or not np.all(np.isfinite(value)):
        raise ModelError(f"{file}: {name}.{key} must be numbers of shape {_SHAPES[key]}.")
    return value


def _rpm(file: str, name: str, its: Mapping[str, Array], key: str) -> float:
    """Rotor speed for a thrust by the thrust map (upper root)."""
    c0, c1, c2 = its["rpm2thrust"]
    inside = c1 * c1 - 4 * c2 * (c0 - float(its[key]))
    if c2 <= 0 or inside < 0:
        raise ModelError(f"{file}: {name}.rpm2thrust never reaches {key} = {float(its[key]):g} N.")
    return float((-c1 + np.sqrt(inside)) / (2 * c2))
