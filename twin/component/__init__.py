"""Equations written once: components, their builder, noise, and rows evaluated in a batch."""

from .builder import ComponentBuilder
from .component import (
    Causality,
    Component,
    Continuous,
    DelayLine,
    Run,
    Sampling,
    Shortcut,
    State,
    Variable,
    check_range,
    substeps,
    unknown_name,
)

__all__ = [
    "Causality",
    "Component",
    "ComponentBuilder",
    "Continuous",
    "DelayLine",
    "Run",
    "Sampling",
    "Shortcut",
    "State",
    "Variable",
    "check_range",
    "substeps",
    "unknown_name",
]
