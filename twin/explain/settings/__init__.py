"""The numbers of a search that decide what it says, in one frozen object, `SearchSettings`.

Every number has a unit, a meaning and an origin; `docs/reference/settings.md` lists them. The
object is made once and handed down: a function takes the group of its own room and no more. This is
the lowest room of `twin.explain`: it imports none of the others, so every other may import it.
"""

from .design import DesignSettings
from .group import Setting
from .inference import (
    AdequacySettings,
    EvidenceSettings,
    InferenceSettings,
    LikelihoodSettings,
    SelectionSettings,
)
from .proof import AttributionSettings, HoldoutSettings, LocalizationSettings
from .search import DEFAULT, SearchSettings
from .stochastic import (
    GustSettings,
    NoiseLevelSettings,
    SlowForceSettings,
    StochasticSettings,
    StuckSettings,
    VibrationSettings,
)
from .unnamed import UnnamedSettings
from .usable import UsableSettings

__all__ = [
    "DEFAULT",
    "AdequacySettings",
    "AttributionSettings",
    "DesignSettings",
    "EvidenceSettings",
    "GustSettings",
    "HoldoutSettings",
    "InferenceSettings",
    "LikelihoodSettings",
    "LocalizationSettings",
    "NoiseLevelSettings",
    "SearchSettings",
    "SelectionSettings",
    "Setting",
    "SlowForceSettings",
    "StochasticSettings",
    "StuckSettings",
    "UnnamedSettings",
    "UsableSettings",
    "VibrationSettings",
]
