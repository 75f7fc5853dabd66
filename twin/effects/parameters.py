"""Numbers of an effect, and their prior: how often a model lacks the effect, how large it is then,
and its variation between flights.

Numbers of a prior are in multiples of the parameter's `scale`, as its range is. Priors were chosen
with knowledge of RflySimDT's and NanoBench's flights and none of the hidden-effects benchmark; the
reason of each states the source of its size.

| odds | log prior odds | for |
|---|---|---|
| UNMEASURED | -1 | numbers that are not measured, and that every aircraft has |
| COMMON | -2.5 | causes that many aircraft have, and most files omit |
| RARE | -4 | causes that need a special circumstance |
| LAST | -7 | causes that could explain almost anything, considered last |
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from ..component import Kind
from ..vehicle import Vehicle

TRIFLE = 0.01
"""Smallest relevant change of a number as a share of its range: a percent of the mass."""


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """One number of an effect.

    Attributes:
        name: Name within the effect, ending in its unit where it has one (`k_xy_1_s`).
        unit: SI unit.
        description: Description in one line.
        start: Typical value, used once the effect is switched on.
        bounds: Smallest and largest value that a fit considers.
        neutral: Value at which the effect vanishes; None for a shape (a height, a time constant
            of something else).
        scale: Vehicle quantity of which start, bounds and neutral are multiples; None: absolute.
        per_rotor: Whether there is one per rotor: `name_1`, `name_2`, ...
        trifle: Smallest change that is named, in the unit of `bounds`; None: `TRIFLE` of the range.
        floor: Smallest value for a vehicle, absolute, where that is below the bounds.
        kind: Kind of its values.
        ends: Whether a value at a bound is plausible, as for a share of none or all, and no hint at
            another effect.
        modes: Additional start values of a search, which would not reach them otherwise.
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
        """Smallest change that is named."""
        low, high = self.bounds
        return TRIFLE * (high - low) if self.trifle is None else self.trifle

    def names(self, vehicle: Vehicle) -> list[str]:
        """Names of its numbers: one, or one per rotor."""
        if not self.per_rotor:
            return [self.name]
        return [f"{self.name}_{i}" for i in range(1, vehicle.rotors.count + 1)]

    def sized(self, vehicle: Vehicle) -> "EffectParameter":
        """The parameter with absolute numbers for a vehicle."""
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
"""Natural logarithm of the prior odds that an effect is present, probabilities 0.27, 0.08, 0.02 and
0.001. By judgement; each prior states its reason."""


@dataclass(frozen=True, slots=True)
class Normal:
    """Normal prior of a number, given that its effect is present.

    Attributes:
        mean: Mean, in the unit of the parameter over its `scale`.
        sd: Standard deviation, in the same unit.
        day: Standard deviation between flights of one aircraft; 0: all flights share the number.
    """

    mean: float
    sd: float
    day: float = 0.0

    def sized(self, parameter: EffectParameter, vehicle: Vehicle) -> "Normal":
        """The prior with absolute numbers for a vehicle."""
        return self if parameter.scale is None else self.scaled(parameter.scale(vehicle))

    def scaled(self, k: float) -> "Normal":
        """The prior scaled by a factor."""
        return Normal(k * self.mean, k * self.sd, k * self.day)


def always_said(_: Vehicle) -> bool:
    """False: every vehicle file states such a cause."""
    return False


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior of an effect.

    Attributes:
        odds: Log prior odds that a model lacks the effect.
        reason: Source of odds and sizes.
        numbers: Prior by number of the effect, or by the start of its name; "" for all others.
        indoors: Prior for flights indoors, of those numbers that differ there.
        corrects: Key of the vehicle file that the effect corrects, "body.mass".
        start: Whether a calibration starts with it, however rare it is.
        timed: Whether its number shifts signals in time although the effect is no `Shift`: no
            linearisation separates such numbers.
        least: Smallest number that a flight can distinguish from none, for a vehicle; None: any.
        written: Value of the key that it corrects, in the unit of its number; None: the number's
            own scale, or 1.
        whole: Whether `numbers` describe the whole quantity: a change of the model is the whole
            less what is written.
        unsaid: Whether a vehicle file states nothing of the cause, so that it counts as unmeasured.
        one_sided: Whether a change can only increase it, as for damage or added parts.
    """

    odds: float
    reason: str
    numbers: Mapping[str, Normal]
    indoors: Mapping[str, Normal] = field(default_factory=dict)
    corrects: str | None = None
    start: bool = False
    timed: bool = False
    least: Callable[[Vehicle], float | None] = field(default=lambda _: None, repr=False)
    written: Callable[[Vehicle], float] | None = field(default=None, repr=False)
    whole: bool = False
    unsaid: Callable[[Vehicle], bool] = field(default=always_said, repr=False)
    one_sided: bool = False

    def change(self, whole: Normal, vehicle: Vehicle) -> Normal:
        """Prior of the change of a vehicle's model, from that of the whole quantity.

        The vehicle's own number is evidence as well, within a factor of two: half of it widens the
        distribution.
        """
        own = self.written(vehicle) if self.whole and self.written else 0.0
        return Normal(whole.mean - own, math.hypot(whole.sd, own / 2), whole.day)

    def odds_for(self, vehicle: Vehicle) -> float:
        """Log prior odds that a vehicle's model lacks the effect."""
        return max(self.odds, UNMEASURED) if self.unsaid(vehicle) else self.odds

    def of(self, name: str, indoors: bool) -> Normal:
        """Prior of a number of the effect, by the longest start of its name."""
        known = {**self.numbers, **self.indoors} if indoors else self.numbers
        return known[max((k for k in known if name.startswith(k)), key=len)]
