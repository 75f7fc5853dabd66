"""The whole twin, with or without a compensator: as one fused FMU, and as one FMU per part."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from fmus import FmuModel, build, component_model, fuse
from twin.component import Component
from twin.errors import TwinError
from twin.flight.assembly import Assembly, connected_by_name
from twin.physics.airframe import REPORTED

from .system import Connection, System

COMPENSATOR = "compensator"
"""Name of the compensator, as a part and in exports."""
PHASE = "phase"
"""Additional input of a driven twin: the phase of flight, which none of its parts can know."""
STEP_S = 1e-3
"""Step of the whole twin: of its fused FMU, and of the co-simulation of its parts."""


def fused_model(assembly: Assembly, vehicle: str, compensator: FmuModel | None = None) -> FmuModel:
    """The whole twin as the model of one FMU, with or without a compensator."""
    parts = parts_of(assembly, compensator)
    text = f"Flying twin of {vehicle}: {', '.join(parts)} in one"
    return fuse("corrected_twin", text, parts, _wires(assembly, parts), STEP_S)


def system_of(
    assembly: Assembly,
    folder: Path,
    fmi: int = 2,
    platforms: Sequence[str] = ("linux64",),
    progress: Callable[[float], None] = lambda _: None,
    compensator: FmuModel | None = None,
) -> System:
    """The whole twin as one FMU per part, built into a folder, and connections."""
    fmus: dict[str, Path] = {}
    parts = parts_of(assembly, compensator)
    for name, part in parts.items():
        model = component_model(part) if isinstance(part, Component) else part
        fmus[name] = build(model, folder / f"{name}.fmu", fmi, platforms)
        progress(len(fmus) / len(parts))
    connections = tuple(Connection(a, b) for a, b in _wires(assembly, parts))
    return System(fmus, connections, stop_time_s=assembly.duration_s, step_s=STEP_S)


def parts_of(assembly: Assembly, compensator: FmuModel | None) -> dict[str, Component | FmuModel]:
    """Parts by name.

    Raises:
        TwinError: The compensator has an input without a source.
    """
    parts: dict[str, Component | FmuModel] = dict(assembly.parts)
    if compensator is None:
        return parts
    given = {
        name.removeprefix(REPORTED)
        for part in assembly.parts.values()
        for name in part.output_names
    }
    wanted = (n for n in compensator.input_names if "." not in n and n != PHASE)
    missing = [n for n in wanted if n not in given]
    if missing:
        raise TwinError(
            f"the compensator reads {', '.join(missing)}, which this twin does not give: was it "
            f"trained on measured rotor speeds, and is the vehicle driven by commands?"
        )
    return parts | {COMPENSATOR: compensator}


def _wires(
    assembly: Assembly, parts: Mapping[str, Component | FmuModel]
) -> tuple[tuple[str, str], ...]:
    """Connections of the assembly, and those of the compensator by name."""
    if COMPENSATOR not in parts:
        return assembly.connections
    own = f"{COMPENSATOR}."
    named = [w for w in connected_by_name(parts) if any(end.startswith(own) for end in w)]
    more = [(_by_number(parts, output), target) for output, target in named]
    fed = {target for _, target in more}
    shown = ((key, name) for key, part in assembly.parts.items() for name in part.output_names)
    more += [
        (f"{key}.{name}", target)
        for key, name in shown
        if name.startswith(REPORTED)
        and name.removeprefix(REPORTED) in parts[COMPENSATOR].input_names
        and (target := own + name.removeprefix(REPORTED)) not in fed
    ]
    return (*assembly.connections, *more)


def _by_number(parts: Mapping[str, Component | FmuModel], output: str) -> str:
    """Output with the code of an enumeration, since libcosim and ecos support numbers only."""
    part, _, name = output.partition(".")
    code = f"{name}_code"
    return f"{part}.{code}" if code in parts[part].output_names else output
