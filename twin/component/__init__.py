"""Equations written once: components, their builder, noise, and rows evaluated in a batch."""

from .builder import ComponentBuilder
from .component import (
    Causality,
    Component,
    DelayLine,
    Run,
    Sampling,
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
    "DelayLine",
    "Run",
    "Sampling",
    "State",
    "Variable",
    "check_range",
    "substeps",
    "unknown_name",
]
