"""Equations written once: components, their builder, noise, and rows evaluated in a batch."""

from .builder import ComponentBuilder
from .component import (
    Component,
    Continuous,
    DelayLine,
    Run,
    Sampling,
    Shortcut,
    State,
    substeps,
)
from .variable import (
    LARGEST_INTEGER,
    Causality,
    Enumeration,
    Kind,
    Variable,
    check_range,
    unknown_name,
)

__all__ = [
    "LARGEST_INTEGER",
    "Causality",
    "Component",
    "ComponentBuilder",
    "Continuous",
    "DelayLine",
    "Enumeration",
    "Kind",
    "Run",
    "Sampling",
    "Shortcut",
    "State",
    "Variable",
    "check_range",
    "substeps",
    "unknown_name",
]
