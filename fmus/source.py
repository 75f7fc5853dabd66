"""The generated C of an FMU: a file per part with its tables, one with its kernels where these are
compiled separately, and `system.c`, which connects the parts.

Names and numbers of a model come from files; they enter C only through `c_string`, `c_number`,
`c_list` and `names`. The output is a literal or a checked identifier, so no value can end it and
continue as code.
"""

import math
import re
from collections.abc import Iterable, Mapping

from twin.component import Enumeration, Sampling, Variable
from twin.errors import FmuError

from .model import Constant, Exchange, FmuModel, Submodel
from .names import check_identifier, check_variable, shown

_PLAIN = frozenset(map(chr, range(0x20, 0x7F))) - frozenset('"\\?')
"""Characters that need no escape in a string; `?` does, since two of them begin a trigraph of
C99."""


def c_string(text: str) -> str:
    """A string literal of the text as UTF-8.

    Raises:
        FmuError: The text contains the character 0, which ends a string of C, or half a character.
    """
    try:
        encoded = text.encode()
    except UnicodeEncodeError:
        encoded = b"\0"
    if 0 in encoded:
        raise FmuError(f"{shown(text)} cannot be a string of C: take the character 0 out of it.")
    # An octal escape has at most three digits, so the next character is never part of it.
    plain = (chr(b) if chr(b) in _PLAIN else f"\\{b:03o}" for b in encoded)
    return f'"{"".join(plain)}"'


def c_number(value: float) -> str:
    """An integer, or a double that is read back unchanged.

    Raises:
        FmuError: It is not finite, or no number.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise FmuError(f"{shown(value)} cannot be a constant of C: give a finite number.")
    return int.__repr__(value) if isinstance(value, int) else float.__repr__(value)


def c_list(values: Iterable[float]) -> str:
    """Initialiser of an array of numbers.

    Raises:
        FmuError: One of them is not finite.
    """
    return f"{{{', '.join(map(c_number, values))}}}"


_NUMBER = re.compile(r"(?<== )-?\d\.\d{16}e[+-]\d+(?=;)")
"""A number in a kernel that may depend on a vehicle; small integers have no exponent."""


def generated_sources(model: FmuModel, token: str) -> dict[str, str]:
    """Generated C files by name.

    Raises:
        FmuError: A name is no identifier, or a number is not finite.
    """
    return {
        **{f"part_{part.name}.c": _part(part) for part in model.parts},
        **{f"kernels_{part.name}.c": _kernels(part) for part in model.parts if part.apart},
        "system.c": _system(model, token),
    }


def _kernels(part: Submodel) -> str:
    """Separately compiled kernels: they contain the number of variables, but no name and no
    number."""
    defines = {"KERNELS": "", **_shared(part)}
    array, places = _numbers(part), iter(range(len(_NUMBER.findall(part.kernels))))
    kernels = _NUMBER.sub(lambda _: f"{array}[{next(places)}]", part.kernels)
    for kernel, tried in (part.shortcuts or {}).items():
        name = check_identifier(f"{part.name}: kernel", f"{kernel.upper()}_SHORTCUTS")
        defines[f"{name}(TRY)"] = " ".join(f"TRY({c_number(i)})" for i in tried)
    return "\n".join(
        [
            "#include <math.h>\n",
            '#include "core.h"',
            '#include "kernel.h"\n',
            *_defined(defines),
            f"extern const double {array}[];\n" * (kernels != part.kernels),
            kernels,
            _glue(part),
        ]
    )


def _numbers(part: Submodel) -> str:
    """Name of the array in `part_NAME.c` with the numbers of its kernels, one by one: two that are
    equal in one model may differ in another with the same kernels."""
    return f"numbers_of_{check_identifier('part of an FMU', part.name)}"


def _shared(part: Submodel) -> dict[str, object]:
    """Macros shared by kernels and tables of a part."""
    parameters, inputs = len(part.of("parameter")), len(part.of("input"))
    shared: dict[str, object] = {
        "PART": check_identifier("part of an FMU", part.name),
        "FIRST_INPUT": 1 + parameters,
        "FIRST_OUTPUT": 1 + parameters + inputs,
        **{
            check_identifier(f"{part.name}: macro", k): _constant(v)
            for k, v in part.defines.items()
        },
    }
    if part.sampling is not None:
        shared["SAMPLED"] = ""
        shared["N_NOISE"] = c_number(part.sampling.channels)
        shared["N_LINES"] = len(part.sampling.lines)
    if part.exchange is not None:
        shared["EXCHANGED"] = ""
    return shared


def _defined(defines: Mapping[str, object]) -> list[str]:
    return [f"#define {name} {value}".rstrip() for name, value in defines.items()]


def _glue(part: Submodel) -> str:
    check_identifier(f"{part.name}: glue", part.glue.removesuffix(".h"))
    return f'#include "{part.glue}"\n'


def _part(part: Submodel) -> str:
    """Tables, kernels unless they are separate, and the glue; all static except for the model."""
    shared = _shared(part)
    defines = {
        "MODEL": f"model_{part.name}",
        "N_VARIABLES": len(part.variables) + 1,
        "N_STATES": len(part.state_names),
        "MAX_STEP": c_number(part.max_step_s),
        "FOLDER": c_string(part.folder),
        **shared,
    }
    states = "".join(f"{c_string(name)}, " for name in part.state_names)
    return "\n".join(
        [
            "#include <math.h>\n",
            '#include "core.h"\n',
            *_defined(defines),
            "",
            _table(
                "static const Variable variables[]",
                [
                    '{"time", OUTPUT, REAL, 0, -HUGE_VAL, HUGE_VAL, 0}',
                    *(_variable(v, v.name in part.may_lack) for v in part.variables),
                ],
            ),
            f"static const char* const state_names[] = {{{states}0}};\n",
            *([] if part.sampling is None else [_sampling(part, part.sampling)]),
            *([] if part.exchange is None else [_exchange(part, part.exchange)]),
            _table(f"const double {_numbers(part)}[]", _NUMBER.findall(part.kernels) or ["0"])
            if part.apart
            else part.kernels,
            _glue(part),
        ]
    )


def _constant(value: Constant) -> str:
    return c_list(value) if isinstance(value, tuple) else c_number(value)


def _variable(v: Variable, may_lack: bool) -> str:
    """One line of the interface table."""
    name = c_string(check_variable("variable of an FMU", v.name))
    causality = "FIXED_PARAMETER" if v.fixed else check_identifier(v.name, v.causality.upper())
    minimum, maximum = v.minimum, v.maximum
    if isinstance(v.kind, Enumeration):
        minimum, maximum = 0, len(v.kind.items) - 1
    low = "-HUGE_VAL" if minimum is None else c_number(float(minimum))
    high = "HUGE_VAL" if maximum is None else c_number(float(maximum))
    row = (name, causality, v.kind_name.upper(), c_number(float(v.start)), low, high, int(may_lack))
    return f"{{{', '.join(map(str, row))}}}"


def _sampling(part: Submodel, sampling: Sampling) -> str:
    reference = {v.name: i for i, v in enumerate(part.variables, start=1)}
    defines = {
        "SAMPLE_PERIOD": reference[sampling.period],
        "SEED": 0 if sampling.seed is None else reference[sampling.seed],
        "STREAM": f"{c_number(sampling.stream)}u",
    }
    lines = [f"{{{c_string(line.name)}, {c_number(line.samples)}}}" for line in sampling.lines]
    return "\n".join(
        [
            *_defined(defines),
            "",
            _table("static const Line lines[]", lines or ["{0, 0}"]),
        ]
    )


def _exchange(part: Submodel, exchange: Exchange) -> str:
    reference = {v.name: i for i, v in enumerate(part.variables, start=1)}
    states = [
        f"{{{s.place}, {reference[s.name]}, {reference[s.derivative]}, {c_number(s.nominal)}}}"
        for s in exchange.states
    ]
    crossings = [str(reference[name]) for name in exchange.crossings]
    return "\n".join(
        [
            f"#define N_CONTINUOUS {len(states)}",
            f"#define N_CROSSINGS {len(crossings)}\n",
            _table("static const Continuous continuous[]", states or ["{0, 0, 0, 0}"]),
            _table("static const unsigned crossings[]", crossings or ["0"]),
        ]
    )


def _system(model: FmuModel, token: str) -> str:
    """The parts, the variables of the FMU and the connections, as C."""
    place = {
        v.name: (i, reference)
        for i, part in enumerate(model.parts)
        for reference, v in enumerate(part.variables, start=1)
    }
    ports = [
        f"{{{i}, {reference}, {len(entry.members)}}}"
        for entry in model.entries
        for i, reference in [place[entry.first.name]]
    ]
    ends = sorted(((place[a], place[b]) for a, b in model.connections), key=lambda ends: ends[1])
    connections = [
        f"{{{', '.join(f'{{{i}, {reference}, 1}}' for i, reference in pair)}}}" for pair in ends
    ]
    names = [f"model_{part.name}" for part in model.parts]
    return "\n".join(
        [
            "#include <math.h>\n",
            '#include "core.h"\n',
            f"extern const Model {', '.join(names)};\n",
            _table("static const Model* const models[]", (f"&{name}" for name in names)),
            _table("static const Port ports[]", ["{0, 0, 1}", *ports]),
            _table(
                "static const Connection connections[]", connections or ["{{0, 0, 1}, {0, 0, 1}}"]
            ),
            _table("static const unsigned visits[]", map(str, model.order)),
            "const System fmu = {",
            f"    .token = {c_string(token)},",
            f"    .step = {'HUGE_VAL' if model.step_s is None else c_number(model.step_s)},",
            f"    .n_parts = {len(names)},",
            "    .models = models,",
            f"    .n_ports = {len(ports) + 1},",
            "    .ports = ports,",
            f"    .n_connections = {len(connections)},",
            "    .connections = connections,",
            f"    .n_visits = {len(model.order)},",
            "    .visits = visits,",
            "};\n",
        ]
    )


def _table(declaration: str, rows: Iterable[str]) -> str:
    """A constant array, one row per line."""
    return declaration + " = {\n" + "".join(f"    {row},\n" for row in rows) + "};\n"
