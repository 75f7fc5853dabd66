"""Short texts of objects, for results in a console that contain megabytes."""

from collections.abc import Collection, Mapping, Set
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

LONGEST = 240
"""Largest number of characters of a text, about three lines of a console."""
_TEXT, _ITEMS = 40, 4
"""Largest number of characters of an inner text, and of items of a collection, that are written in
full."""


class ShortRepr:
    """Base of dataclasses whose `repr` is `short_repr`."""

    __slots__ = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.__repr__ = short_repr  # type: ignore[method-assign]  # kept by `dataclass`


def short_repr(self: Any) -> str:
    """Class and fields of a dataclass: arrays by their shape, collections by their size; at most
    `LONGEST` characters."""
    parts: list[str] = []
    length = len(type(self).__name__) + 2
    for field in sorted((f for f in fields(self) if f.repr), key=lambda f: bool(f.kw_only)):
        part = f"{field.name}={_short(getattr(self, field.name))}"
        length += len(part) + 2
        if length > LONGEST - 3:
            parts.append("...")
            break
        parts.append(part)
    return f"{type(self).__name__}({', '.join(parts)})"


def _short(value: Any) -> str:
    """A value in short form."""
    if value is None or isinstance(value, bool | int):
        return repr(value)
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Path):
        return _short(str(value))
    if isinstance(value, str):
        return repr(value if len(value) <= _TEXT else f"{value[: _TEXT - 3]}...")
    if isinstance(value, bytes):
        return f"<{len(value)} bytes>"
    if is_dataclass(value):
        name = getattr(value, "name", None)
        return f"{type(value).__name__}({_short(name) if isinstance(name, str) else '...'})"
    if (shape := getattr(value, "shape", None)) is not None:  # array, table, tensor, CasADi matrix
        size = "x".join(map(str, shape() if callable(shape) else shape))
        return f"<{type(value).__name__} {size or 'scalar'}>"
    if isinstance(value, Collection):
        return _collection(value)
    return f"<{type(value).__name__}>"


def _collection(value: Collection[Any]) -> str:
    """The items if they are few and simple, else their number."""
    simple = all(isinstance(v, str | int | float | None) for v in value)
    if len(value) > _ITEMS or not simple:
        return f"<{len(value)} of {type(value).__name__}>"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{_short(k)}: {_short(v)}' for k, v in value.items())}}}"
    items = ", ".join(
        _short(v) for v in (sorted(value, key=str) if isinstance(value, Set) else value)
    )
    if isinstance(value, tuple):
        return f"({items}{',' * (len(value) == 1)})"
    return f"[{items}]" if isinstance(value, list) else f"{{{items}}}"
