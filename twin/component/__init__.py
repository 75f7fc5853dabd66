"""Equations written once: components, their builder, noise, and rows evaluated in a batch."""

from .builder import ComponentBuilder, built_once
from .component import (
    LARGEST_INTEGER,
    Causality,
    Component,
    Continuous,
    DelayLine,
    Enumeration,
    Kind,
    Run,
    Sampling,
    Shortcut,
    State,
    Variable,
    check_range,
    check_starts,
    substeps,
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
    "built_once",
    "check_range",
    "check_starts",
    "substeps",
    "unknown_name",
]
