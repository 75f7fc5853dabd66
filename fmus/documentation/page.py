"""The page that an FMU carries: what it is, how it is run, its frames, its variables and effects.

FMI 2.0.1 section 2.3 and FMI 3.0 section 2.5.1: `documentation/index.html` is where tools begin,
`documentation/licenses/license.txt` is the licence. `icon.png` is `icon.svg`, drawn by
a browser.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import resources

import jinja2

from twin.component import Variable
from twin.effects import EFFECTS, Effect

from ..model import FmuModel
from .project import project
from .terminals import terminals_and_icons


@dataclass(frozen=True, slots=True)
class EffectRows:
    """An effect that an FMU can switch on.

    Attributes:
        place: Its block of parameters, "airframe.rotor_drag".
        effect: What it is.
        numbers: Its parameters, the switch first.
    """

    place: str
    effect: Effect
    numbers: tuple[Variable, ...]


def documentation(model: FmuModel, fmi: int) -> dict[str, bytes]:
    """Members of the archive, the same bytes for the same model.

    Args:
        model: What the FMU computes; its texts may come from files and are escaped.
        fmi: 2 or 3.
    """
    effects = tuple(effect_rows(model))
    of_effects = {v.name for e in effects for v in e.numbers}
    parameters = [v for v in model.variables if v.causality == "parameter"]
    page = _template().render(
        model=model,
        fmi=fmi,
        project=project(),
        inputs=[v for v in model.variables if v.causality == "input"],
        outputs=[v for v in model.variables if v.causality == "output"],
        locals=[v for v in model.variables if v.causality == "local"],
        parameters=[v for v in parameters if v.name not in of_effects],
        effects=effects,
        arrays=[entry for entry in model.entries if entry.is_array],
    )
    return {
        "documentation/index.html": page.encode(),
        "documentation/licenses/license.txt": project().text.encode(),
        **_icon(model, fmi),
    }


def _icon(model: FmuModel, fmi: int) -> dict[str, bytes]:
    """Where each version looks for it; with it, in FMI 3, the terminals."""
    own = resources.files(__package__)
    if fmi == 2:
        return {"model.png": (own / "icon.png").read_bytes()}
    return {
        "terminalsAndIcons/icon.png": (own / "icon.png").read_bytes(),
        "terminalsAndIcons/icon.svg": (own / "icon.svg").read_bytes(),
        "terminalsAndIcons/terminalsAndIcons.xml": terminals_and_icons(model),
    }


def effect_rows(model: FmuModel) -> Iterator[EffectRows]:
    """Effects among the parameters of a model, in their order."""
    blocks: dict[str, list[Variable]] = {}
    for v in model.variables:
        place, _, _ = v.name.rpartition(".")
        if v.causality == "parameter" and place.rpartition(".")[2] in EFFECTS:
            blocks.setdefault(place, []).append(v)
    switched = {p: n for p, n in blocks.items() if f"{p}.enabled" in {v.name for v in n}}
    for place, numbers in switched.items():
        yield EffectRows(place, EFFECTS[place.rpartition(".")[2]], tuple(numbers))


@cache
def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(__package__, "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template("page.html.j2")
