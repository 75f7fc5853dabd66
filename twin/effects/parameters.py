"""Numbers of an effect, and what is expected of them before any flight: how often the effect is
missing from a model, how large it then is, and by how much it differs between flights.

Numbers of a prior are in multiples of the parameter's `scale`, as its range is. Priors were written
down with RflySimDT's and NanoBench's flights in view and with none of the hidden-effects benchmark;
the reason of each says where its size comes from.

| odds | log prior odds | for |
|---|---|---|
| UNMEASURED | -1 | numbers that nobody measures, and that are off on every aircraft |
| COMMON | -2.5 | what many aircraft have, and most files leave out |
| RARE | -4 | what needs a special cause |
| LAST | -7 | what would explain almost anything, and is thought of last |
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from ..component import Kind
from ..vehicle import Vehicle

TRIFLE = 0.01
"""Share of its range by which a number moves at least where an effect is one to speak of:
a percent of the mass."""


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One number of an effect.

    Attributes:
        name: Within the effect, ending in its unit where it has one (`k_xy_1_s`).
        unit: SI unit.
        description: One line.
        start: A middling size, which counts once the effect is switched on.
        bounds: Smallest and largest value that a fit considers.
        neutral: Value at which the effect vanishes; None for a shape (a height, a time constant
            of something else).
        scale: Vehicle quantity that start, bounds and neutral are multiples of; None: absolute.
        per_rotor: Whether every rotor has one: `name_1`, `name_2`, ...
        trifle: Smallest change worth a name, in the unit of `bounds`; None: `TRIFLE` of that range.
        floor: Smallest value that a vehicle allows, absolute, where that is below the bounds.
        kind: What its values are.
        ends: Whether it may well be at a bound, as a share may be none or all: that is no hint that
            another effect is meant.
        modes: Values that a search begins at as well, as it would not find the way there.
    """

    name: str
    unit: str
    description: str
    start: float
    bounds: tuple[float, float]
    neutral: float | None = 0.0
    scale: Callable[[Vehicle], float] | None = None
    per_rotor: bool = False
    trifle: float | None = None
    floor: Callable[[Vehicle], float] | None = None
    ends: bool = False
    kind: Kind = "real"
    modes: tuple[float, ...] = ()

    @property
    def smallest(self) -> float:
        """Smallest change worth a name."""
        low, high = self.bounds
        return TRIFLE * (high - low) if self.trifle is None else self.trifle

    def names(self, vehicle: Vehicle) -> list[str]:
        """Names of its numbers: one, or one per rotor."""
        if not self.per_rotor:
            return [self.name]
        return [f"{self.name}_{i}" for i in range(1, vehicle.rotors.count + 1)]

    def sized(self, vehicle: Vehicle) -> "EffectParameter":
        """The same with absolute numbers for a vehicle."""
        k = 1.0 if self.scale is None else self.scale(vehicle)
        low, high = (k * b for b in self.bounds)
        neutral, trifle = (None if v is None else k * v for v in (self.neutral, self.trifle))
        return replace(
            self,
            start=k * self.start,
            bounds=(low if self.floor is None else min(low, self.floor(vehicle)), high),
            neutral=neutral,
            trifle=trifle,
            scale=None,
            floor=None,
        )


UNMEASURED, COMMON, RARE, LAST = -1.0, -2.5, -4.0, -7.0
"""Natural logarithm of the prior odds that an effect is there, probabilities 0.27, 0.08, 0.02 and
0.001. By judgement; each prior gives its reason."""


@dataclass(frozen=True, slots=True)
class Normal:
    """What a number is expected to be where its effect is there.

    Attributes:
        mean: In the unit of the parameter over its `scale`.
        sd: Standard deviation.
        day: Standard deviation between flights of one aircraft; 0: all flights share the number.
    """

    mean: float
    sd: float
    day: float = 0.0

    def sized(self, parameter: EffectParameter, vehicle: Vehicle) -> "Normal":
        """The same with absolute numbers for a vehicle."""
        return self if parameter.scale is None else self.scaled(parameter.scale(vehicle))

    def scaled(self, k: float) -> "Normal":
        """The same in multiples of a number."""
        return Normal(k * self.mean, k * self.sd, k * self.day)


def nothing_yet(_: Vehicle) -> float:
    """Of a number that is a change of the model by itself."""
    return 0.0


def always_said(_: Vehicle) -> bool:
    """Of a cause of which a vehicle always says something."""
    return False


@dataclass(frozen=True, slots=True)
class Prior:
    """What is expected of an effect.

    Attributes:
        odds: Log prior odds that a model lacks it.
        reason: Where odds and sizes come from.
        numbers: By number of the effect, or by the beginning of its name; "" for all others.
        indoors: The same where the aircraft flies under a roof, of those that differ there.
        corrects: Key of the vehicle file that the effect puts right, "body.mass".
        start: Whether a calibration begins with it, however rare it is.
        timed: Whether its number moves signals in time though the effect is no shift of them: no
            linearisation tells such numbers apart.
        least: Smallest number that a flight can tell from none, for a vehicle; None: any.
        already: What a vehicle's own numbers hold of the quantity that `numbers` are about, in its
            unit: `numbers` are about the whole, a change of the model is the whole less this.
        unsaid: Whether a vehicle says nothing of the cause, so that it counts as unmeasured.
        one_sided: Whether a change only adds, as of what broke or was strapped on.
    """

    odds: float
    reason: str
    numbers: Mapping[str, Normal]
    indoors: Mapping[str, Normal] = field(default_factory=dict)
    corrects: str | None = None
    start: bool = False
    timed: bool = False
    least: Callable[[Vehicle], float | None] = field(default=lambda _: None, repr=False)
    already: Callable[[Vehicle], float] = field(default=nothing_yet, repr=False)
    unsaid: Callable[[Vehicle], bool] = field(default=always_said, repr=False)
    one_sided: bool = False

    def change(self, whole: Normal, vehicle: Vehicle) -> Normal:
        """Distribution of the change of a vehicle's model, of that of the whole quantity.

        The vehicle's own number is evidence, too, good to a factor of two: half of it widens the
        distribution.
        """
        own = self.already(vehicle)
        return Normal(whole.mean - own, math.hypot(whole.sd, own / 2), whole.day)

    def odds_for(self, vehicle: Vehicle) -> float:
        """Log prior odds that a vehicle's model lacks the effect."""
        return max(self.odds, UNMEASURED) if self.unsaid(vehicle) else self.odds

    def of(self, name: str, indoors: bool) -> Normal:
        """Of a number of the effect, by the longest beginning of its name."""
        known = {**self.numbers, **self.indoors} if indoors else self.numbers
        return known[max((k for k in known if name.startswith(k)), key=len)]
