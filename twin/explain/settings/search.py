"""All settings of a search."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field

from ...representation import short_repr
from .design import DesignSettings
from .group import Group, Value
from .inference import InferenceSettings
from .proof import AttributionSettings, HoldoutSettings, LocalizationSettings
from .stochastic import StochasticSettings
from .unnamed import UnnamedSettings
from .usable import UsableSettings


@dataclass(frozen=True, slots=True)
class SearchSettings(Group):
    """Every number that decides what a search says, by the room of `twin.explain` that asks.

    Attributes:
        usable: Which flights are looked at at all.
        inference: Which effects, with which probabilities.
        stochastic: Which effects that change no mean.
        unnamed: When an equation takes the place of a name.
        holdout: How the gap is shown.
        attribution: On which channels and in which phases an effect is said to act.
        localization: Which places of disagreement are told.
        design: What to fly next.
    """

    usable: UsableSettings = field(default_factory=UsableSettings)
    inference: InferenceSettings = field(default_factory=InferenceSettings)
    stochastic: StochasticSettings = field(default_factory=StochasticSettings)
    unnamed: UnnamedSettings = field(default_factory=UnnamedSettings)
    holdout: HoldoutSettings = field(default_factory=HoldoutSettings)
    attribution: AttributionSettings = field(default_factory=AttributionSettings)
    localization: LocalizationSettings = field(default_factory=LocalizationSettings)
    design: DesignSettings = field(default_factory=DesignSettings)

    __repr__ = short_repr

    @property
    def changed(self) -> Mapping[str, Value]:
        """Values that are not the default ones, by name."""
        usual = {s.name: s.value for s in DEFAULT.every()}
        return {s.name: s.value for s in self.every() if s.value != usual[s.name]}

    @property
    def hash(self) -> str:
        """Of all names and values: equal for equal settings of the same version, 12 digits."""
        text = "\n".join(f"{s.name} = {s.value!r}" for s in self.every())
        return hashlib.sha256(text.encode()).hexdigest()[:12]


DEFAULT = SearchSettings()
"""What is used where nothing else is asked for."""
