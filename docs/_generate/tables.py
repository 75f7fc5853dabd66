"""Write the tables of the documentation from the definitions in code.

    python docs/_generate/tables.py [--check]

Each document holds a pair of markers; what stands between them is replaced. `--check` changes
nothing and exits 1 if a table is out of date.
"""

import ast
import inspect
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption
from typer.main import get_command

from cosim.whole_twin import fused_model
from learning.force.model import ForceFile
from learning.model.registry import FAMILIES, family_named
from twin.component import Component, Enumeration, Variable
from twin.effects import EFFECTS, Effect, EffectParameter, effects_for, prior_of
from twin.effects.parameters import (
    COMMON,
    LAST,
    RARE,
    UNMEASURED,
    Normal,
    Prior,
    always_said,
)
from twin.explain import settings as settings_of_search
from twin.explain.model.model import has_mean
from twin.explain.setting_group import Value, numbers
from twin.explain.settings import DEFAULT
from twin.flight.assembly import COMPONENTS, Choices, driven_twin
from twin.logs.columns import COLUMNS
from twin.logs.formats import FORMATS
from twin.vehicle import Vehicle
from twin.vehicle.plausibility import BANDS
from twin.vehicle.vehicle import WORDS
from twin.vehicle_file import load_vehicle
from twin.vehicle_file.fields import FIELDS
from uavtwin.cli.main import VERBS, app
from uavtwin.cli.options import Prints
from uavtwin.cli.vehicle import vehicle as vehicle_app
from uavtwin.exports.bands import AccuracyRecord
from uavtwin.exports.credibility import CredibilityRecord
from uavtwin.fleets.dataset import TABLES
from uavtwin.output import RunRecord
from uavtwin.record import keys, sections, summary_of
from uavtwin.series.files import SIDES
from uavtwin.series.mcap import FOXGLOVE, MEANINGS, TOPICS

DOCS = Path(__file__).parents[1]
BEGIN = "<!-- table: do not edit, run docs/_generate/tables.py -->"
END = "<!-- end of table -->"
FILES: dict[str, type] = {
    "accuracy.json": AccuracyRecord,
    "credibility.json": CredibilityRecord,
    "force.json": ForceFile,
    "run.json": RunRecord,
}
"""Files with keys that no verb prints."""
EXAMPLE = "crazyflie"
"""Vehicle whose start values are shown: it has a battery, so every component exists."""


def rows(head: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table."""
    cells = [[text.replace("|", "\\|") for text in line] for line in (head, *lines)]
    content = [f"| {' | '.join(line)} |" for line in cells]
    return [content[0], "|" + "---|" * len(head), *content[1:]]


def flight_table() -> str:
    """Columns of the flight table."""
    lines = [(f"`{c.name}`", c.unit or "-", c.description) for c in COLUMNS]
    return "\n".join(rows(("column", "unit", "meaning"), lines))


def log_formats() -> str:
    """Formats of flight logs."""
    lines = [
        (
            f.name,
            ", ".join(f"`{s}`" for s in f.suffixes) or "none",
            str(f.signature),
            ", ".join(f.packages),
            f.holds,
        )
        for f in FORMATS
    ]
    return "\n".join(rows(("format", "usual ending", "begins with", "package", "holds"), lines))


def series() -> str:
    """Topics of a flight in MCAP, and the columns of the series of results."""
    units = {c.name: c.unit for c in COLUMNS}
    topics = [(f"`{t}`", f"`{FOXGLOVE[t]['title']}`", meaning) for t, meaning in MEANINGS.items()]
    for topic, columns in TOPICS.items():
        fields = ", ".join(f"`{c}`" for c in columns)
        unit = ", ".join(dict.fromkeys(units[c] for c in columns))
        topics.append((f"`{topic}`", "numbers", f"{fields}; {unit}"))
    sides = [(f"`{side}`", verbs, meaning) for side, (verbs, meaning) in SIDES.items()]
    return "\n".join(
        [
            "## Topics of a flight",
            "",
            *rows(("topic", "schema", "holds"), topics),
            "",
            "## Columns of a result",
            "",
            *rows(("before the point", "of", "meaning"), sides),
        ]
    )


def fleet() -> str:
    """Columns of the dataset of a fleet, a table per table."""
    parts = []
    for table, columns in TABLES.items():
        lines = [(f"`{c.name}`", c.unit or "-", c.meaning) for c in columns]
        parts.append("\n".join([f"## {table}", "", *rows(("column", "unit", "holds"), lines)]))
    return "\n\n".join(parts)


def compensator() -> str:
    """Families of compensators and their presets."""
    lines = [
        (
            f"`{f.name}`",
            f.meaning,
            ", ".join(f"`{p}`" for p in f.presets),
            "yes" if f.onnx else "no",
        )
        for f in map(family_named, FAMILIES)
    ]
    return "\n".join(rows(("family", "is", "`--preset`", "ONNX, FMU"), lines))


def vehicle() -> str:
    """Keys of the vehicle file, a table per section."""
    sections: dict[str, list[Sequence[str]]] = {}
    for key, field in FIELDS.items():
        section, _, name = key.partition(".")
        unit = field.unit.removeprefix("poly:") or "-"
        sign = {True: "; > 0", False: "; >= 0", None: ""}[field.positive]
        needed = "yes" if field.required else "no"
        line = (f"`{name}`", f"{unit}{sign}", needed, field.meaning)
        sections.setdefault(section, []).append(line)
    head = ("key", "unit", "needed", "meaning")
    tables = ["\n".join([f"## [{n}]", "", *rows(head, lines)]) for n, lines in sections.items()]
    return "\n\n".join([*tables, _words_of_sources(), _bands()])


def _words_of_sources() -> str:
    """What stands in for a standard deviation that is not given."""
    lines = [
        (", ".join(f'"{w}"' for w in row.words), f"{100 * row.share:g} %", row.reason)
        for row in WORDS
    ]
    head = ("word in `source`", "standard deviation", "why")
    return "\n".join(["## Words of a source", "", *rows(head, lines)])


def _bands() -> str:
    """Where the numbers of multirotors usually lie."""
    lines = [(b.quantity, str(b), b.origin) for b in BANDS]
    head = ("quantity", "usual", "origin")
    return "\n".join(["## What check asks", "", *rows(head, lines)])


# -- FMUs -----------------------------------------------------------------------------------


def fmus() -> str:
    """Variables of every component, a table each; inputs and outputs of the twin that is driven."""
    model = load_vehicle(EXAMPLE)
    choices = Choices(effects_for(model), mission="tour")
    parts = [_component(name, make(model, choices)) for name, make in COMPONENTS.items()]
    return "\n\n".join([*parts, _driven(model)])


def _driven(model: Vehicle) -> str:
    """Inputs and outputs of the fused twin that takes motor commands."""
    fused = fused_model(driven_twin(model, "command"), model.name)
    ports = [v for v in fused.variables if v.causality in ("input", "output")]
    return "\n".join(
        [
            "## corrected-twin --drive commands",
            "",
            "Inputs and outputs of the fused twin. Parameters are those of its parts above, with "
            "the name of the part in front. `--evidence` adds `accuracy.*` "
            "([how far off](evidence.md#how-far-off)).",
            "",
            *_variables(ports),
        ]
    )


def _component(name: str, component: Component) -> str:
    """Variables of one component; effects by name only, numbered variables in one line."""
    owners = [v.name.split(".")[0] for v in component.parameters]
    effects = [f"`{e}`" for e in EFFECTS if e in owners]
    own = [v for v in component.variables if v.name.split(".")[0] not in EFFECTS]
    return "\n".join(
        [
            f"## {name}",
            "",
            f"{component.description}.",
            *([f"Effects ([numbers](effects.md)): {', '.join(effects)}."] if effects else []),
            "",
            *_variables(own),
        ]
    )


def _variables(given: Iterable[Variable]) -> list[str]:
    """A table; numbered variables in one line."""
    groups: dict[str, list[Variable]] = {}
    for v in given:
        groups.setdefault(re.sub(r"_\d+\b", "_{i}", v.name), []).append(v)
    lines = [_group(pattern, group) for pattern, group in groups.items()]
    return rows(("variable", "kind", "unit", "start", "meaning"), lines)


def _group(pattern: str, group: list[Variable]) -> Sequence[str]:
    """One line for a variable, or for those that differ in a number."""
    first, meaning = group[0], group[0].meaning
    if len(group) > 1:
        pattern = pattern.format(i=f"{{1..{len(group)}}}")
        meaning = re.sub(r"(rotor|motor|waypoint) 1\b", r"\1 i", meaning, flags=re.IGNORECASE)
    starts = list(dict.fromkeys(_start(v) for v in group))
    unit = first.unit if first.real else first.kind_name
    return f"`{pattern}`", first.causality, unit, ", ".join(starts), meaning


def _start(v: Variable) -> str:
    if v.causality == "output":
        return "-"
    return f"{v.start:.4g}" if v.real else v.start_text


# -- effects --------------------------------------------------------------------------------


def effects() -> str:
    """The effect library: an overview, then the parameters."""
    model = load_vehicle("copter_default")
    overview = [
        (f"`{e.name}`", e.component, e.meaning, ", ".join(f"`{n}`" for n in e.needs), e.source)
        for e in EFFECTS.values()
    ]
    numbers = [
        _number(e.name, p, model, mark)
        for e in EFFECTS.values()
        for own, mark in ((e.parameters, ""), (e.of_logs, "†"))
        for p in own
    ]
    declined = [
        (f"`{what}`", meaning, ", ".join(f"`{e.name}`" for e in _without(what)))
        for what, meaning in DECLINED.items()
    ]
    return "\n".join(
        [
            "## Effects",
            "",
            *rows(("effect", "in", "meaning", "needs", "source"), overview),
            "",
            "## Declined on purpose",
            "",
            *rows(("by `None`", "means", "effects"), declined),
            "",
            "## Parameters",
            "",
            *rows(("parameter", "unit", "start", "range", "meaning"), numbers),
        ]
    )


DECLINED = {
    "prior": "rare, and anywhere in its range; or it changes no mean",
    "change": "it does not change from one flight to the next",
    "wording": "a report gives its numbers alone",
    "advice": "there is nothing in particular to fly for it",
}
"""What an effect declines by None, and what that means."""


def _without(what: str) -> list[Effect]:
    return [e for e in EFFECTS.values() if getattr(e, what) is None]


def _number(effect: str, parameter: EffectParameter, model: Vehicle, note: str) -> Sequence[str]:
    p = parameter.sized(model)
    name = f"`{effect}.{p.name}{'_1..n' if p.per_rotor else ''}`{note}"
    mark = "\\*" if parameter.scale is not None else ""
    ends = "\\*" if parameter.scale is not None or parameter.floor is not None else ""
    low, high = p.bounds
    meaning = p.description
    if isinstance(p.kind, Enumeration):
        meaning += f": {p.kind.legend}"
    return name, p.unit, f"{p.start:.3g}{mark}", f"{low:.3g} to {high:.3g}{ends}", meaning


# -- priors ---------------------------------------------------------------------------------

ODDS = {UNMEASURED: "unmeasured", COMMON: "common", RARE: "rare", LAST: "last"}


def priors() -> str:
    """What is expected of every effect before a flight, and of what changes on an aircraft."""
    usual = {name: prior_of(e) for name, e in EFFECTS.items() if has_mean(e)}
    changes = {name: e.change for name, e in EFFECTS.items() if e.change is not None}
    only_more = ", ".join(f"`{e}`" for e, change in changes.items() if change.one_sided)
    return "\n".join(
        [
            "## Of an aircraft",
            "",
            *_priors(usual),
            "",
            "## Of a change",
            "",
            f"Nothing else changes. Only more, never less: {only_more}.",
            "",
            *_priors(changes),
        ]
    )


def _priors(known: Mapping[str, Prior]) -> list[str]:
    """One line for the numbers of an effect of which the same is expected."""
    model, lines = load_vehicle("copter_default"), []
    for name, prior in known.items():
        effect, groups = EFFECTS[name], dict[tuple[str, ...], list[str]]()
        for p in (*effect.parameters, *effect.of_logs):
            here, indoors = (_expected(prior.of(p.name, i), p, model) for i in (False, True))
            same = (p.unit, *here, "-" if here == indoors else "; ".join(indoors))
            groups.setdefault(same, []).append(f"`{p.name}{'_1..n' if p.per_rotor else ''}`")
        odds = f"{ODDS[prior.odds]}{'' if prior.unsaid is always_said else '†'}"
        corrects = "-" if prior.corrects is None else f"`{prior.corrects}`"
        for i, (facts, names) in enumerate(groups.items()):
            own = (f"`{name}`", odds, corrects, prior.reason) if i == 0 else ("", "", "", "")
            lines.append((*own[:2], ", ".join(names), *facts, *own[2:]))
    numbers = ("number", "unit", "mean", "sd", "day", "indoors")
    head = ("effect", "odds", *numbers, "corrects", "reason")
    return rows(head, lines)


def _expected(normal: Normal, parameter: EffectParameter, model: Vehicle) -> tuple[str, str, str]:
    """Mean, deviation, and deviation between days."""
    of_voltage = parameter.unit == "V" and parameter.neutral is None
    n = normal if of_voltage else normal.sized(parameter, model)
    mark = " U" if of_voltage else "" if parameter.scale is None else "\\*"
    mean, sd, day = (f"{x:.3g}{mark if x else ''}" for x in (n.mean, n.sd, n.day))
    return mean, sd, day if n.day else "-"


# -- settings -------------------------------------------------------------------------------


ORIGINS = "Physics|Paper|Data sheet|Measured|Chosen on|Sensitivity|Made up"
"""First words of the origin of a setting."""


def settings() -> str:
    """Numbers that decide what `explain` says, a table per group."""
    groups: dict[str, list[Sequence[str]]] = {}
    for name, value, meaning, origin in told_settings():
        group, _, own = name.rpartition(".")
        shown = ", ".join(f"{x:.4g}" for x in numbers(value))
        groups.setdefault(group, []).append((f"`{own}`", shown, meaning, origin))
    return "\n\n".join(
        "\n".join([f"## {group}", "", *rows(("setting", "value", "meaning", "origin"), own)])
        for group, own in groups.items()
    )


def told_settings() -> Iterator[tuple[str, Value, str, str]]:
    """Name, value, meaning and origin of each setting, by the docstring of its field."""
    classes = [n for n in parsed(settings_of_search) if isinstance(n, ast.ClassDef)]
    told = {(c.name, f): text for c in classes for f, text in attribute_docstrings(c)}
    for s in DEFAULT.every():
        *path, own = s.name.split(".")
        text = told[type(reduce(getattr, path, DEFAULT)).__name__, own]
        split = re.fullmatch(rf"(.+)\. (({ORIGINS})\b.*)\.", text)
        assert split is not None, (s.name, text)
        yield s.name, s.value, split[1], split[2]


def parsed(module: ModuleType) -> Sequence[ast.stmt]:
    """Statements of a module."""
    return ast.parse(inspect.getsource(module)).body


def attribute_docstrings(of: ast.ClassDef) -> Iterator[tuple[str, str]]:
    """Name and docstring, on one line, of each field of a class that has one."""
    for field, text in pairwise(of.body):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
            yield ast.unparse(field.target), " ".join(ast.literal_eval(text.value).split())


# -- command line ---------------------------------------------------------------------------


def command_line() -> str:
    """Every verb with its arguments and options."""
    group = get_command(app)
    assert isinstance(group, TyperGroup)
    return "\n\n".join(_verb(name, command) for name, command in _verbs(group))


def _verbs(group: TyperGroup, before: str = "") -> Iterator[tuple[str, TyperCommand]]:
    """Verbs, and those of groups such as `vehicle convert`."""
    for name, command in group.commands.items():
        if isinstance(command, TyperGroup):
            yield from _verbs(command, f"{before}{name} ")
        elif isinstance(command, TyperCommand) and not command.hidden:
            yield f"{before}{name}", command


def _verb(name: str, command: TyperCommand) -> str:
    """One verb: how to call it, what it does, a table of its options."""
    parameters = [p for p in command.params if isinstance(p, TyperArgument | TyperOption)]
    arguments = [p for p in parameters if isinstance(p, TyperArgument)]
    call = " ".join(["uavtwin", name, *(_argument(p) for p in arguments)])
    lines = [_option(p) for p in parameters if not p.hidden]
    meaning = (command.help or "").strip()
    return "\n".join(
        [
            f"## {name}",
            "",
            f"`{call}`",
            "",
            meaning,
            "",
            *rows(("argument or option", "default", "meaning"), lines),
        ]
    )


def _argument(argument: TyperArgument) -> str:
    return str(argument.name).upper() + ("..." if argument.nargs == -1 else "")


def _option(parameter: TyperArgument | TyperOption) -> Sequence[str]:
    """One line of the table: names, default, help text."""
    if isinstance(parameter, TyperArgument):
        names = f"`{_argument(parameter)}`"
    else:
        names = ", ".join(f"`{n}`" for n in (*parameter.opts, *parameter.secondary_opts))
    given = parameter.default
    plain = given is None or given is False or given == "" or callable(given)
    default = "needed" if parameter.required else ("-" if plain else f"`{given}`")
    return names, default, parameter.help or "-"


def json_keys() -> str:
    """A section of keys for every verb with `--json`, and for what several of them hold."""
    parts: list[str] = []
    shared: dict[str, type] = {}
    for name, verb in _callbacks():
        parameter = inspect.signature(verb).parameters.get("as_json")
        prints = [a for a in getattr(parameter and parameter.annotation, "__metadata__", ())]
        for about in (a for a in prints if isinstance(a, Prints)):
            classes = [_class(text) for text in about.records]
            tables = [_keys_table(record) for record in classes]
            heading = about.file or f"{name} --json"
            parts.append(
                "\n\n".join([f"## {heading}", *([about.about] * bool(about.about)), *tables])
            )
            shared |= {s: c for record in classes for s, c in sections(record).items()}
    own = [
        f"### {heading[0].upper()}{heading[1:]}\n\n{summary_of(c)}\n\n{_keys_table(c)}"
        for heading, c in sorted(shared.items())
        if f"## {heading}\n" not in "\n".join(parts)
    ]
    files = [f"## {name}\n\n{summary_of(c)}\n\n{_keys_table(c)}" for name, c in FILES.items()]
    return "\n\n".join([*parts, *files, "## Held by several", *own])


def _callbacks() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Verbs and their functions."""
    yield from ((verb.__name__, verb) for verb in VERBS)
    for command in vehicle_app.registered_commands:
        assert command.callback is not None
        yield f"vehicle {command.callback.__name__.rstrip('_')}", command.callback


def _class(text: str) -> type:
    module, _, name = text.partition(":")
    found: type = getattr(import_module(module), name)
    return found


def _keys_table(record: type) -> str:
    lines = [(f"`{k.path}`", k.type, k.meaning) for k in keys(record)]
    return "\n".join(rows(("key", "is", "holds"), lines))


def limits() -> str:
    """What each page of use says that its verb cannot tell, under the title of the page."""
    pages = [*sorted((DOCS / "guide").glob("*.md")), DOCS / "reference" / "simulators.md"]
    return "\n\n".join(filter(None, map(_limits, pages)))


_LIMITS = re.compile(r"(?ms)^## What it (?:cannot tell|does not hold)\n+(.*?)(?=^## |\Z)")
"""The section of a page."""
_LINK = re.compile(r"\]\((?!https?:)([^)#]*)(#[^)]*)?\)")
"""A link to a page or to an anchor."""


def _limits(page: Path) -> str:
    """Of one page; "" where it has no such section."""
    text = page.read_text("utf-8")
    found = _LIMITS.search(text)
    if found is None:
        return ""

    def moved(match: re.Match[str]) -> str:
        """A link as it is from here."""
        target, anchor = match.groups(default="")
        own = f"../{page.parent.name}/"
        return f"]({target if target.startswith('../') else own + (target or page.name)}{anchor})"

    title = text.partition("\n")[0].removeprefix("# ")
    link = f"../{page.parent.name}/{page.name}"
    return f"## [{title}]({link})\n\n{_LINK.sub(moved, found.group(1)).strip()}"


def examples() -> str:
    """Each script of `examples/`, whole."""
    return "\n".join(
        f"\n## {path.name}\n\n```python\n{path.read_text('utf-8').rstrip()}\n```"
        for path in sorted((DOCS.parent / "examples").glob("*.py"))
    )


DOCUMENTS = {
    "reference/examples.md": examples,
    "reference/limits.md": limits,
    "reference/flight_table.md": flight_table,
    "reference/vehicle_fields.md": vehicle,
    "reference/fmu_variables.md": fmus,
    "reference/effects.md": effects,
    "reference/priors.md": priors,
    "reference/settings.md": settings,
    "reference/cli.md": command_line,
    "reference/json.md": json_keys,
    "reference/log_formats.md": log_formats,
    "reference/series.md": series,
    "method/compensator.md": compensator,
    "reference/tables.md": fleet,
}


def main(check: bool) -> int:
    """Bring all tables up to date; how many were not."""
    stale = 0
    for name, table in DOCUMENTS.items():
        path = DOCS / name
        text = path.read_text("utf-8")
        head, rest = text.split(BEGIN)
        _, tail = rest.split(END)
        wanted = f"{head}{BEGIN}\n{table()}\n{END}{tail}"
        if wanted != text:
            stale += 1
            print(f"{name} is out of date")
            if not check:
                path.write_text(wanted, "utf-8")
    return stale


if __name__ == "__main__":
    sys.exit(1 if main("--check" in sys.argv) and "--check" in sys.argv else 0)
