"""Vehicles of other simulators as vehicle files: TOML with unit and source for every number.

`docs/reference/simulators.md` lists the key and the conversion law of each of their numbers.
"""

from pathlib import Path

from ...errors import ModelError
from ..read import toml_tree
from .common import read_xml
from .drone_models import convert_drone_models, is_drone_models
from .gazebo import convert_gazebo
from .jsbsim import convert_jsbsim
from .pyflyt import convert_pyflyt, is_pyflyt

KNOWN = (
    "SDF of Gazebo (.sdf), params.toml of drone-models, NAME.yaml of PyFlyt with NAME.urdf next to "
    "it, the aircraft XML of JSBSim"
)  # names of formats in messages


def convert_vehicle(path: str | Path, name: str | None = None) -> str:
    """Text of a vehicle file for a vehicle in a file of another simulator.

    Args:
        path: Path of the file; its format is recognised by content.
        name: Name of the aircraft, where the file contains several.

    Raises:
        ModelError: No such file, an unknown format, or a vehicle that a vehicle file cannot
            describe; the text says what to do.
    """
    file = Path(path)
    if not file.is_file():
        raise ModelError(f"{file}: no such file.")
    suffix = file.suffix.lower()
    if suffix == ".toml":
        tree = toml_tree(_text(file), file.name)
        if is_drone_models(tree):
            return convert_drone_models(tree, file, name)
    elif suffix in (".yaml", ".yml"):
        text = _text(file)
        if is_pyflyt(text):
            return convert_pyflyt(text, file)
    elif suffix in (".sdf", ".world", ".xml"):
        root = read_xml(file).tag
        if root == "sdf":
            return convert_gazebo(file, name)
        if root == "fdm_config":
            return convert_jsbsim(file)
    raise ModelError(f"{file.name}: not a format that is known here: {KNOWN}.")


def _text(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path.name}: cannot be read as text: {error}.") from error


__all__ = ["convert_vehicle"]
