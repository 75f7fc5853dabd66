"""Interface of a co-simulation FMU: its variables, units, dependencies and capabilities."""

from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path

import fmpy
import numpy as np
from fmpy.model_description import ModelDescription, ScalarVariable

from fmus.archive import open_archive
from twin.errors import FmuError
from twin.representation import ShortRepr

_INTEGERS: dict[str, type[np.generic]] = {
    f"{sign}Int{bits}": np.dtype(f"{sign.lower()}int{bits}").type
    for bits in (8, 16, 32, 64)
    for sign in ("", "U")
}  # Int8 to UInt64 of FMI 3
SCALARS: dict[int, dict[str, tuple[str, type[np.generic]]]] = {
    2: {
        "Real": ("Real", np.float64),
        "Integer": ("Integer", np.int32),
        "Enumeration": ("Integer", np.int32),
        "Boolean": ("Boolean", np.int32),
    },
    3: {
        "Float64": ("Float64", np.float64),
        "Float32": ("Float32", np.float32),
        **{name: (name, dtype) for name, dtype in _INTEGERS.items()},
        "Enumeration": ("Int64", np.int64),
        "Boolean": ("Boolean", np.bool_),
    },
}
"""FMI type -> name in the get and set functions, NumPy type of its buffer, by FMI version."""

_SAVES = ("canGetAndSetFMUstate", "canGetAndSetFMUState")  # FMI 2, FMI 3
_DERIVATIVES = ("providesDirectionalDerivative", "providesDirectionalDerivatives")  # FMI 2, FMI 3


@dataclass(frozen=True, slots=True)
class Port(ShortRepr):
    """A variable of an FMU for the master.

    Attributes:
        nominal: Typical magnitude, 1 where the FMU has none.
        settable: Whether it accepts a start value.
        kind: "Real", "Integer", "Boolean" or "Enumeration"; None for other types.
        items: Value -> name of an enumeration.
    """

    name: str
    unit: str | None
    type: str
    reference: int
    causality: str
    nominal: float
    settable: bool
    kind: str | None
    items: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True)
class Interface(ShortRepr):
    """One FMU, read but not loaded."""

    path: Path
    description: ModelDescription

    @cached_property
    def fmi(self) -> int:
        """FMI version, 2 or 3."""
        return 2 if self.description.fmiVersion.startswith("2") else 3

    @cached_property
    def ports(self) -> dict[str, Port]:
        """All variables by name."""
        return {v.name: _port(v) for v in self.description.modelVariables}

    def port(self, name: str) -> Port:
        """The variable of that name.

        Raises:
            FmuError: There is none; the text names the most similar one.
        """
        if name not in self.ports:
            near = get_close_matches(name, self.ports, n=1, cutoff=0.5)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise FmuError(f"{self.path.name}: there is no variable {name!r}.{hint}")
        return self.ports[name]

    def scalar(self, name: str) -> Port:
        """The variable of that name, if its type is supported by the master.

        Raises:
            FmuError: It is an array, a text or another type.
        """
        port = self.port(name)
        if port.kind is None:
            raise FmuError(
                f"{self.path.name}: {name} is {port.type}; only Real, Integer, Boolean and "
                f"Enumeration scalars can be connected, recorded or set."
            )
        return port

    def value(self, port: Port, value: float) -> float | int | bool:
        """A start value converted to the type of its variable.

        Raises:
            FmuError: It would have to be rounded, or is no item of an enumeration.
        """
        if port.kind == "Real":
            return float(value)
        allowed = "whole numbers"
        known = {code: name for name, code in port.items}
        fits = np.isfinite(value) and value == int(value)
        if port.kind == "Boolean":
            fits, allowed = value in (0, 1), "0 and 1"
        elif port.kind == "Enumeration" and known:
            fits, allowed = value in known, ", ".join(f"{c} {known[c]}" for c in sorted(known))
        elif fits:
            limits = np.iinfo(np.dtype(SCALARS[self.fmi][port.type][1]))
            low, high = int(limits.min), int(limits.max)
            fits, allowed = low <= value <= high, f"whole numbers from {low} to {high}"
        if not fits:
            raise FmuError(
                f"{self.path.name}: {port.name} = {value:.15g} is no {port.kind} value; {allowed} "
                f"can be set."
            )
        return bool(value) if port.kind == "Boolean" else int(value)

    def names(self, *causalities: str) -> list[str]:
        """Scalars of these causalities, in the FMU's order, without arrays and texts."""
        return [p.name for p in self.ports.values() if p.causality in causalities and p.kind]

    @property
    def saves_state(self) -> bool:
        """Whether a step can be rolled back."""
        return self._can(*_SAVES)

    @property
    def has_derivatives(self) -> bool:
        """Whether it provides directional derivatives."""
        return self._can(*_DERIVATIVES)

    @property
    def varies_step(self) -> bool:
        """Whether its communication steps may vary in length."""
        return self._can("canHandleVariableCommunicationStepSize")

    def _can(self, *names: str) -> bool:
        part = self.description.coSimulation
        return any(getattr(part, n, None) in (True, "true", "1") for n in names)

    def dependencies(self, initial: bool = False) -> dict[str, set[str]]:
        """Inputs on which each output directly depends; all inputs where the FMU does not declare
        it.

        Args:
            initial: Whether at the end of initialisation, when an input may also act through the
                initial states; else while stepping.
        """
        inputs = set(self.names("input"))
        lists = [self.description.outputs]
        if initial:
            lists.append(self.description.initialUnknowns)
        result = {name: inputs for name in self.names("output")}
        for unknown in [u for some in lists for u in some]:
            known = unknown.dependencies
            if unknown.variable.name in result:
                result[unknown.variable.name] = (
                    inputs if known is None else {k.name for k in known} & inputs
                )
        return result


def read_interface(path: Path) -> Interface:
    """Read the description of a co-simulation FMU.

    Raises:
        FmuError: Not a readable FMU, or not one for co-simulation.
    """
    open_archive(path)  # refuses unsafe descriptions
    try:
        description = fmpy.read_model_description(path)
    except Exception as error:  # FMPy and lxml raise many kinds
        raise FmuError(f"{path.name}: not a readable FMU: {error}") from error
    if description.fmiVersion.startswith("1"):
        raise FmuError(f"{path.name}: FMI {description.fmiVersion}; the master runs FMI 2 and 3.")
    if description.coSimulation is None:
        raise FmuError(f"{path.name}: not a co-simulation FMU; the master needs one.")
    return Interface(path, description)


def _port(v: ScalarVariable) -> Port:
    declared = v.declaredType
    array = bool(v.dimensions)
    nominal = v.nominal or getattr(declared, "nominal", None)
    return Port(
        name=v.name,
        unit=v.unit or getattr(declared, "unit", None),
        type=f"an array of {v.type}" if array else v.type,
        reference=v.valueReference,
        causality=v.causality,
        nominal=abs(float(nominal or 0)) or 1.0,
        settable=v.causality in ("parameter", "input")
        or (v.initial in ("exact", "approx") and v.variability != "constant"),
        kind=None if array else _kind(v.type),
        items=tuple((i.name, int(i.value)) for i in getattr(declared, "items", ())),
    )


def _kind(fmi_type: str) -> str | None:
    if fmi_type in ("Real", "Float64", "Float32"):
        return "Real"
    if fmi_type == "Integer" or fmi_type in _INTEGERS:
        return "Integer"
    return fmi_type if fmi_type in ("Boolean", "Enumeration") else None
