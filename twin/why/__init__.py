"""Why a flight went wrong, from its log alone: no vehicle file, no mass, no size."""

from .diagnose import diagnose
from .records import Diagnosis, Event

__all__ = ["Diagnosis", "Event", "diagnose"]
