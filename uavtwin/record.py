"""Records of results: every number is a field, computed once.

JSON, JSON Schema and the reference of JSON keys are generated from the fields; tables, sentences
and pages print them. A field is documented in the `Attributes:` of its class, in the order of the
fields.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from inspect import cleandoc
from typing import Any, ClassVar

import msgspec
from msgspec import inspect


class Record(msgspec.Struct, frozen=True, kw_only=True):
    """Content of a JSON file or of `--json`: its keys are the fields, in their order.

    A field of type `UnsetType` is omitted where it is not set. Numbers that are not finite become
    null.
    """

    digits: ClassVar[int | None] = None
    """Significant digits of numbers that are no integers; None: all."""

    def json(self) -> dict[str, Any]:
        """The record as strict JSON content."""
        return dict(plain(self, self.digits))


def plain(value: Any, digits: int | None = None) -> Any:
    """Records, dataclasses and arrays as strict JSON content.

    Args:
        value: Records, dataclasses, containers, numbers and texts.
        digits: Significant digits of numbers that are no integers; None: all.

    Returns:
        Null for a number that is not finite, lists for tuples and arrays.
    """
    return _strict(msgspec.to_builtins(value, str_keys=True, enc_hook=_of_numpy), digits)


def content_of(value: Any) -> Any:
    """A record, a dataclass or several as strict JSON content."""
    if isinstance(value, list | tuple):
        return [content_of(v) for v in value]
    return value.json() if isinstance(value, Record) else plain(value)


def _of_numpy(value: Any) -> Any:
    """A numpy scalar or array as Python values; others as text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _strict(value: Any, digits: int | None) -> Any:
    if isinstance(value, dict):
        return {k: _strict(v, digits) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(v, digits) for v in value]
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else float(f"{value:.{digits}g}")
    return value


class Section(Record, frozen=True, kw_only=True):
    """A record that several results contain: its keys have a separate section in the reference."""

    section: ClassVar[str] = ""
    """Heading of the section."""


class Headline(Record, frozen=True, kw_only=False):
    """Headline of a result.

    Attributes:
        text: One or more sentences.
        numbers: Fitted numbers that the text gives, "effect.number": each has a 95 % interval that
            excludes `no_effect` and a `prior_share` of at most 0.5.
    """

    text: str
    numbers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Key:
    """A key of JSON content.

    Attributes:
        path: Path from the top: "channels.*.rms", "flights[].name".
        type: "number", "text", "list of number", ...
        meaning: Meaning of the value.
    """

    path: str
    type: str
    meaning: str


def keys(record: type) -> Iterator[Key]:
    """Every key of a record or dataclass, those of nested ones after their parent.

    Raises:
        TypeError: A field is not documented.
    """
    yield from _keys(inspect.type_info(record), "")


def _keys(kind: inspect.Type, path: str) -> Iterator[Key]:
    """Keys of all records in a type.

    Args:
        kind: Type of the value.
        path: Path of the value.
    """
    match kind:
        case inspect.StructType() | inspect.DataclassType():
            about, before = documented(kind.cls), f"{path}." if path else ""
            for field in kind.fields:
                name = field.encode_name
                if name not in about:
                    raise TypeError(f"{kind.cls.__qualname__}.{name}: is not in Attributes.")
                missing = ", may be missing" if field.default is msgspec.UNSET else ""
                yield Key(before + name, type_text(field.type) + missing, about[name])
                if not _own_section(field.type):
                    yield from _keys(field.type, before + name)
        case inspect.UnionType():
            for one in kind.types:
                yield from _keys(one, path)
        case inspect.ListType() | inspect.VarTupleType():
            yield from _keys(kind.item_type, f"{path}[]")
        case inspect.DictType():
            yield from _keys(kind.value_type, f"{path}.*")


def sections(record: type) -> dict[str, type]:
    """Classes in a record that have a separate section, by its heading."""
    every = _classes(inspect.type_info(record))
    return {c.section: c for c in every if c is not record and issubclass(c, Section)}


def summary_of(record: type) -> str:
    """First line of the documentation of a class."""
    return cleandoc(record.__doc__ or "").partition("\n")[0]


def _own_section(kind: inspect.Type) -> str:
    """Heading of the section with the keys of a value; "" where they are with the others."""
    if isinstance(kind, inspect.StructType):
        return str(getattr(kind.cls, "section", ""))
    return next((text for text in map(_own_section, _inner(kind)) if text), "")


def _inner(kind: inspect.Type) -> tuple[inspect.Type, ...]:
    """Inner types of a type: fields, members of a union, items."""
    match kind:
        case inspect.StructType() | inspect.DataclassType():
            return tuple(field.type for field in kind.fields)
        case inspect.UnionType():
            return kind.types
        case inspect.ListType() | inspect.VarTupleType():
            return (kind.item_type,)
        case inspect.DictType():
            return (kind.value_type,)
    return ()


def documented(record: type) -> dict[str, str]:
    """Meaning of each field, from the `Attributes:` of the class and of its base classes."""
    found: dict[str, str] = {}
    for cls in reversed(record.__mro__):
        _, _, section = cleandoc(cls.__doc__ or "").partition("Attributes:\n")
        entries = re.split(r"\n(?=\w)", cleandoc(section.partition("\n\n")[0]))
        pairs = (" ".join(entry.split()).partition(": ") for entry in entries)
        found |= {name: meaning for names, _, meaning in pairs for name in names.split(", ")}
    return found


_NAMES: dict[type, str] = {
    inspect.FloatType: "number",
    inspect.IntType: "count",
    inspect.StrType: "text",
    inspect.BoolType: "flag",
    inspect.NoneType: "null",
    inspect.AnyType: "any",
}
"""Names of plain types in the reference."""


def type_text(kind: inspect.Type) -> str:
    """A type in the form of the reference."""
    match kind:
        case inspect.StructType() | inspect.DataclassType():
            return _own_section(kind) or "object"
        case inspect.LiteralType():
            return ", ".join(f'"{value}"' for value in kind.values)
        case inspect.UnionType():
            return " or ".join(type_text(t) for t in kind.types)
        case inspect.TupleType():
            return f"{len(kind.item_types)} of {type_text(kind.item_types[0])}"
        case inspect.ListType() | inspect.VarTupleType():
            return f"list of {type_text(kind.item_type)}"
        case inspect.DictType():
            return f"by name: {type_text(kind.value_type)}"
    return _NAMES.get(type(kind), "text")


def schema(record: type) -> dict[str, Any]:
    """JSON Schema of a record, each key described; any number may be null."""
    made = msgspec.json.schema(record)
    classes = {c.__name__: c for c in _classes(inspect.type_info(record))}
    for name, content in made["$defs"].items():
        content["description"] = content.get("description", "").partition("\n")[0]
        about = documented(classes[name])
        for key, value in content["properties"].items():
            value["description"] = about[key]
    return dict(_nullable(made))


def _classes(kind: inspect.Type) -> Iterator[type]:
    """Classes of all records in a type."""
    if isinstance(kind, inspect.StructType | inspect.DataclassType):
        yield kind.cls
    for inner in _inner(kind):
        yield from _classes(inner)


def _nullable(value: Any) -> Any:
    if isinstance(value, list):
        return [_nullable(v) for v in value]
    if not isinstance(value, dict):
        return value
    content = {k: _nullable(v) for k, v in value.items()}
    return content | ({"type": ["number", "null"]} if content.get("type") == "number" else {})
