"""A vehicle file from what the flights of an aircraft tell and what its owner knows of it."""

from .draft import Drafted, draft
from .facts import Fact, OwnerFacts, kind_of
from .hover import Hover, drives, hover_of

__all__ = ["Drafted", "Fact", "Hover", "OwnerFacts", "draft", "drives", "hover_of", "kind_of"]
