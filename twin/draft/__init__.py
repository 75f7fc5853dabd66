"""A first vehicle file from the flights of an aircraft and the knowledge of its owner."""

from .draft import Drafted, draft
from .facts import Fact, OwnerFacts, kind_of
from .hover import Hover, drives, hover_of

__all__ = ["Drafted", "Fact", "Hover", "OwnerFacts", "draft", "drives", "hover_of", "kind_of"]
