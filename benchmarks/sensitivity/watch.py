"""Which changes of settings can change an answer at all: one run of a case tells for all of them.

A watched setting is its number together with what it would be halved and doubled. Arithmetic
carries all of them along; where a comparison comes out otherwise for one, or a number leaves for
code that cannot be watched (an index, a filter, a fit), that change may matter and is noted. A run
with a change that was not noted does the same step by step, so it need not be made. Whether a
setting was consulted at all is noted, too: what nobody asked for was not tried.
"""

import copy
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_effects.run import explained
from twin.explain.setting_group import Group, Value
from twin.explain.settings import DEFAULT, SearchSettings
from uavtwin.explain_record import explain_record

from .variants import Variant, variants


@dataclass
class Noted:
    """Names of changes of settings that were consulted, and of those among them that may matter."""

    consulted: set[str] = field(default_factory=set)
    may: set[str] = field(default_factory=set)


class Watched:
    """A number, and what it would be with each change of a setting.

    Args:
        value: As it is.
        others: By the name of a change; missing: the same.
        noted: What is noted of changes; added to.
    """

    __slots__ = ("noted", "others", "value")

    def __init__(self, value: Any, others: Mapping[str, Any], noted: Noted) -> None:
        self.value, self.others, self.noted = value, others, noted

    def plain(self) -> Any:
        """The number alone: whatever is done with it may depend on every change."""
        self.noted.consulted.update(self.others)
        self.noted.may.update(self.others)
        return self.value

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **more: Any) -> Any:
        """NumPy's arithmetic, on all of them."""
        return _on_all(lambda *a: getattr(ufunc, method)(*a, **more), inputs)

    def __array__(self, *_: Any, **__: Any) -> Any:
        return np.asarray(self.plain())

    def __float__(self) -> float:
        return float(self.plain())

    def __int__(self) -> int:
        return int(self.plain())

    def __index__(self) -> int:
        return operator.index(self.plain())

    def __bool__(self) -> bool:
        return bool(self.plain())

    def __len__(self) -> int:
        return len(self.plain())

    def __iter__(self) -> Iterator[Any]:
        return iter(self.plain())

    def __getitem__(self, key: Any) -> Any:
        return self.plain()[key]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.plain(), name)

    def __hash__(self) -> int:
        return hash(self.plain())

    def __repr__(self) -> str:
        return repr(self.value)

    def __format__(self, form: str) -> str:
        return format(self.plain(), form)

    def __round__(self, digits: int | None = None) -> Any:
        value = self.plain()
        return round(value, digits) if digits else round(value)

    def __neg__(self) -> Any:
        return _on_all(operator.neg, (self,))


def _on_all(does: Callable[..., Any], inputs: Iterable[Any]) -> Any:
    """The result, watched where changes make it another number; one that is a decision is plain."""
    inputs = [*inputs]
    watched = [x for x in inputs if isinstance(x, Watched)]
    noted = watched[0].noted
    value = does(*(x.value if isinstance(x, Watched) else x for x in inputs))
    others = {}
    changes = {n for x in watched for n in x.others}
    noted.consulted.update(changes)
    for name in changes:
        other = does(
            *(x.others.get(name, x.value) if isinstance(x, Watched) else x for x in inputs)
        )
        if not np.array_equal(other, value, equal_nan=np.asarray(value).dtype.kind == "f"):
            others[name] = other
    if np.asarray(value).dtype == np.bool_:
        noted.may.update(others)
        return value
    return Watched(value, others, noted) if others else value


def _binary(name: str) -> None:
    does = getattr(operator, name)
    own = name.rstrip("_")
    setattr(Watched, f"__{own}__", lambda a, b: _on_all(does, (a, b)))
    if own in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow"):
        setattr(Watched, f"__r{own}__", lambda a, b: _on_all(does, (b, a)))


for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    _binary(_name)
for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow"):
    _binary(_name)


def watched(changes: Iterable[Variant]) -> tuple[SearchSettings, Noted]:
    """Settings that are watched, and what has been noted of changes so far."""
    settings, noted = copy.deepcopy(DEFAULT), Noted()
    by_setting: dict[str, list[Variant]] = {}
    for change in changes:
        by_setting.setdefault(change.setting.name, []).append(change)
    for name, some in by_setting.items():
        *path, own = name.split(".")
        group: Group = settings
        for part in path:
            group = getattr(group, part)
        values = {change.name: change.value for change in some}
        object.__setattr__(group, own, _watched(some[0].setting.value, values, noted))
    return settings, noted


def _watched(value: Value, others: Mapping[str, Any], noted: Noted) -> Any:
    if isinstance(value, tuple):
        return tuple(
            _watched(v, {n: o[i] for n, o in others.items()}, noted) for i, v in enumerate(value)
        )
    return Watched(value, others, noted)


def watch_case(folder: Path) -> dict[str, Any]:
    """What is said about a case with the default settings, and which changes of one of them were
    "consulted" and "may" make it say something else."""
    settings, noted = watched(variants())
    found = explained(folder, settings)
    more = {"may": sorted(noted.may), "consulted": sorted(noted.consulted)}
    return {**explain_record(replace(found, settings=DEFAULT)).json(), **more}
