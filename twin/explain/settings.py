"""Numbers that determine the result of a search, in one frozen object, `SearchSettings`.

The docstring of each number gives meaning, unit and origin; `docs/reference/settings.md` lists them
and explains the origins. The object is created once and passed down: a function takes only the
group of its own package.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from ..vehicle import GRAVITY_M_S2
from .setting_group import Group, Share, Value

# -- which flights are fit for a search ----------------------------------------------------


@dataclass(frozen=True, slots=True)
class UsableSettings(Group):
    """Settings of `twin.explain.usable`."""

    shortest_s: float = 3.0
    """Least time in the air, s. Sensitivity: 5 cases."""
    longest_s: float = 240.0
    """Length, s, of the part of a longer flight that is read, where it moves most. Made up: is
    searched in a minute."""
    impact_m_s2: float = 5 * GRAVITY_M_S2
    """Low-passed specific force, m/s², that a blow reaches but no flight. Sensitivity: 5 cases."""
    impact_hz: float = 20.0
    """Low-pass of that force, Hz. Physics: the body moves below it and rotors vibrate above, as for
    BAND_HZ of twin.residuals.channels."""
    around_s: float = 1.0
    """Time left out before and after a blow, and beside the upright ends of a fall, s. Sensitivity:
    5 cases."""
    upside_down_s: float = 0.2
    """Time upside down from which on it is a crash, s. Made up."""
    tipped_cos: Share = 0.5
    """Cosine of the tilt in the last second below which an aircraft lies on its side. Physics:
    beyond 60 degrees level flight takes more than twice the weight in thrust."""
    latest_s: float = 0.5
    """Largest time between attitude and gyroscope, s: a delay is an effect like others. Physics: a
    reading of the IMU may be 0.2 s late and a clock 0.25 s off (twin.effects.timing)."""
    slow_hz: float = 1.0
    """Frequency below which velocity and position are compared, Hz. Made up."""
    slowest_m_s: float = 0.2
    """Rms velocity from which on they are compared, m/s. Data sheet: four times the noise of a
    u-blox NEO-M8's velocity, 0.05 m/s, which takes 3 % of a correlation then."""
    same_motion: Share = 0.5
    """Correlation from which on two signals are the same motion in the same axes. Physics: halfway
    between 0, which exchanged axes have, and 1."""


# -- which effects, with which probabilities -----------------------------------------------


@dataclass(frozen=True, slots=True)
class LikelihoodSettings(Group):
    """Settings of `twin.explain.inference.whitening`: noise of a channel, for equations and
    designs."""

    order: int = 15
    """Order of the autoregression of a channel's noise, samples. Physics: noise behind a
    second-order low-pass of 6 Hz, that of the slowest channels, is correlated by less than 0.0005
    after 15 samples of 50 Hz."""
    block_s: float = 2.0
    """Length of the time blocks that are left out of a fit and drawn in the bootstrap, s. Physics:
    six times as long as noise of the slowest channels lasts (two periods of POSE_BAND_HZ, 6 Hz)."""
    huber: float = 4.0
    """Standard deviations beyond which an innovation weighs less: Huber, Ann. Math. Stat. 35, 1964.
    Physics: normal innovations at 50 Hz pass it once in five minutes."""
    roughness: Share = 1e-3
    """Share of the unexplained power that is added as white noise, as no model is exact. Made
    up."""


@dataclass(frozen=True, slots=True)
class EvidenceSettings(Group):
    """Settings of `twin.explain.inference.evidence`: prior knowledge of the noise."""

    level: float = 2.0
    """Degrees of freedom of the prior of a band's noise level. Physics: with two the Student t that
    results has a mean and no variance, with one not even that."""
    samples: float = 250.0
    """Samples that a channel of one flight counts as, however fast it was logged. Chosen on:
    RflySimDT real flights and NanoBench; 100 and 600 keep the names."""
    rough: Share = 0.02
    """Share of a band's amplitude that no law explains, being inexact. Chosen on: RflySimDT real
    flights and NanoBench."""
    trim_force: float = 0.01
    """Between-flight standard deviation of a constant specific force, over gravity. Chosen on:
    RflySimDT real flights; three times as much loses the centre of mass."""
    trim_turn: float = 0.0025
    """The same of a moment about x and y, over the weight at the arm. Chosen on: RflySimDT real
    flights; three times as much loses the centre of mass."""
    trim_yaw: float = 0.3
    """The same about z, over that about x and y. Chosen on: RflySimDT real flights."""
    trim_pose: float = 0.005
    """The same between pose and IMU, over gravity and over 0.4 rad/s. Made up: 0.3 degrees of
    levelling, 0.1 deg/s."""
    trim_other: float = 0.02
    """The same of any other sensor, over its size. Made up."""


@dataclass(frozen=True, slots=True)
class SelectionSettings(Group):
    """Settings of `twin.explain.inference.selection`: probabilities from which on an effect is
    named."""

    sure: Share = 0.8
    """Probability from which on an effect is named. Made up."""
    moved: float = 3.0
    """Factor on the odds of an effect from which on flights speak for it. Paper: Kass & Raftery, J.
    Am. Stat. Assoc. 90 (1995): up to it evidence is not worth more than a bare mention."""
    credible: Share = 0.5
    """Probability that the cause is in the library, from which on an effect is named. Physics: more
    likely than not."""
    least: Share = 0.05
    """Probability below which a hypothesis or an effect is no candidate. Paper: one in twenty,
    Fisher, Statistical Methods for Research Workers (1925)."""
    variance_per_effect: float = 1.0
    """Variances of a number that each reported effect adds to it: what one law gets wrong, the
    numbers of the others make up for. Chosen on: half of the cases of benchmarks/hidden_effects as
    in life (docs/results/hidden_effects.md); 0.5 is too few there, 1.5 and 2 do as well."""


@dataclass(frozen=True, slots=True)
class AdequacySettings(Group):
    """Settings of `twin.explain.inference.adequacy`: credibility of a named effect."""

    law: Share = 1 / 7
    """Deviation of a law of the right name from nature's, as a share of what it explains. Measured:
    right names leave 0.14 or less in 25 of 26 cases (docs/results/hidden_effects.md)."""
    power: float = 0.07
    """Deviation of the exponent that flights require of the right effect from that of its law.
    Measured: rms of 0.05 in 31 right names whose exponent is known to 0.06
    (docs/results/hidden_effects.md)."""
    powers: float = 0.5
    """The same of the law of another cause. Physics: a drag with the third power of a speed is the
    power 3/2 of one with the second, and rotor speed the power 1/2 of thrust."""
    outside: Share = 0.1
    """Prior probability that a cause is outside the library. Made up."""
    chance: float = 2.0
    """Standard deviations by which a residual has to exceed noise. Physics: mere noise, if normal,
    exceeds it once in 44."""
    memory: float = 2.0
    """Periods of the highest frequency of a channel after which its noise is forgotten. Physics:
    noise behind a second-order Butterworth low-pass is correlated by less than 0.0002 then."""
    most: int = 4
    """Largest number of effects of a model whose single residuals are judged. Sensitivity: 5
    cases."""


@dataclass(frozen=True, slots=True)
class InferenceSettings(Group):
    """Settings of `twin.explain.inference`."""

    likelihood: LikelihoodSettings = field(default_factory=LikelihoodSettings)
    evidence: EvidenceSettings = field(default_factory=EvidenceSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    adequacy: AdequacySettings = field(default_factory=AdequacySettings)


# -- effects that change no mean -----------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StuckSettings(Group):
    """Settings of `twin.explain.stochastic.search` for stuck readings."""

    shortest_s: float = 0.5
    """Least constant span of a reading, s: shorter ones are lost packets. Sensitivity: 5 cases."""
    longer: float = 10.0
    """Least ratio of the span to the longest one elsewhere, and to that of the other axes then.
    Physics: the longest of n by chance is about ln n, and ten times that comes once in n^9."""
    moving_bits: float = 3.0
    """Least standard deviation of another axis meanwhile, in last bits. Physics: with normal steps
    of 3 bits ten repeats in a row come by chance less than once in 10^8."""
    smooth: float = 0.1
    """Ratio of second to first differences below which a signal is free of noise and may come to
    rest. Sensitivity: 1 case."""


@dataclass(frozen=True, slots=True)
class NoiseLevelSettings(Group):
    """Settings of `twin.explain.stochastic.imu_noise` for noise levels."""

    slowest_hz: float = 80.0
    """Least sample rate, Hz. Physics: the first of `bands` begins at 20 Hz then, above the 18 Hz up
    to which the body moves (BAND_HZ of twin.residuals.channels)."""
    bands: Annotated[tuple[tuple[float, float], ...], 0.5] = (
        (0.25, 0.33),
        (0.33, 0.41),
        (0.41, 0.49),
    )
    """Parts of the band that have to agree, in sample rates. Physics: upper half of what a sample
    rate can hold, in three equal parts."""
    low: Share = 0.2
    """Quantile of the cells that wandering lines leave alone. Made up."""
    flat: float = 1.3
    """Largest ratio of the noise in two parts of the band: force of the air falls by more. Made
    up."""
    known: float = 0.08
    """Standard deviation of the log ratio of the file's noise to that of a reading. Made up."""
    ratios: tuple[float, float] = (0.1, 30.0)
    """Least and largest ratio to the file's noise that is a noise level. Sensitivity: 5 cases."""
    alike: float = 1.25
    """Largest ratio of two sensors with the same cause. Physics: two readings that deviate by
    `known` each differ by less in 95 of 100, exp(1.96 √2 0.08)."""


@dataclass(frozen=True, slots=True)
class VibrationSettings(Group):
    """Settings of `twin.explain.stochastic.imu_noise` for vibration."""

    from_hz: float = 25.0
    """Frequency below which the body moves and controllers oscillate, Hz. Made up."""
    neighbours: Annotated[float, 0.5] = 0.12
    """Half width of the neighbourhood of a line, in sample rates. Made up."""
    overlap: Share = 0.6
    """Independent windows per window, for Hann windows that overlap by a half. Paper: Welch, IEEE
    Trans. Audio Electroacoustics 15 (1967)."""
    line_bins: int = 6
    """Bins on either side that belong to a line that wanders. Made up."""
    motion_share: Share = 0.25
    """Share of a line's power from which on, predicted by the twin, it is motion. Sensitivity: 1
    case."""
    smallest_acc_m_s2: float = 0.02
    """Least rms of a line of the accelerometer, m/s². Data sheet: noise within 200 Hz of an
    accelerometer of 150 µg/√Hz, as the Bosch BMI055."""
    smallest_gyro_rad_s: float = 0.002
    """Least rms of a line of the gyroscope, rad/s. Data sheet: four fifths of the noise within 200
    Hz of a gyroscope of 0.01 °/s/√Hz, as the InvenSense MPU-6500."""
    line_share: Share = 0.05
    """Least share of the power above `from_hz` that a line has. Sensitivity: 1 case."""


@dataclass(frozen=True, slots=True)
class GustSettings(Group):
    """Settings of `twin.explain.stochastic.search` for gusts."""

    band_hz: Annotated[tuple[float, float], 5.0] = (0.1, 3.0)
    """Band of the slow part of the accelerometer residuals, Hz. Made up."""
    window_s: float = 8.0
    """Window of its spectrum, s; shorter pieces of flight are left out. Physics: a Hann window of 8
    s resolves 0.25 Hz, which tells a load from turbulence."""
    fold_s: float = 4.0
    """Length of the time blocks that a regression predicts from the others, s. Made up."""
    folds: int = 5
    """Number of parts of the time that are left out in turn. Paper: Hastie, Tibshirani & Friedman,
    The Elements of Statistical Learning, sec. 7.10: five or ten."""
    floor_hz: Annotated[tuple[float, float], 25.0] = (5.0, 12.0)
    """Band in which the white floor of the 50 Hz channels is read, Hz. Physics: above the slow
    part, and where the low-pass of 18 Hz takes less than a sixth of the power."""
    slope_bands_hz: Annotated[tuple[tuple[float, float], ...], 5.0] = (
        (0.15, 0.35),
        (0.4, 0.8),
        (0.8, 1.5),
        (1.5, 3.0),
    )
    """Bands from each to the next of which the density of turbulence falls, Hz; that of a line or
    load does not. Made up."""
    smallest_fall: float = 0.7
    """Least density of each of these bands over the next; equal ones differ so by chance. Made
    up."""
    lasting_s: float = 2.0
    """Length of the time blocks whose power is compared, s. Made up."""
    lasting: Share = 0.25
    """Least median over mean of the power of these blocks: turbulence goes on, bumps do not.
    Sensitivity: 1 case."""
    unexplained: Share = 0.5
    """Least share of the slow power that no curve explains. Physics: more than half of it."""
    smallest_m_s2: float = 0.03
    """Least rms of the force, m/s². Sensitivity: 1 case."""
    uneven: float = 6.0
    """Largest ratio of the power along x and y: turbulence has no direction to speak of.
    Sensitivity: 1 case."""
    known: float = 0.35
    """Standard deviation of the log slow power of a complete model over its noise floor. Made
    up."""
    typical_drag_1_s: float = 0.25
    """Drag over mass and speed where the model has none, 1/s. Paper: Faessler, Franchi &
    Scaramuzza, IEEE Robotics and Automation Letters 3 (2018): 0.2 to 0.4."""


@dataclass(frozen=True, slots=True)
class StochasticSettings(Group):
    """Settings of `twin.explain.stochastic`."""

    one_of: float = 40.0
    """Number of effects of which one is present: the prior odds of each are one to these. Physics:
    about as many as the library has, 42; beforehand none of them is likelier."""
    line_window_s: float = 0.5
    """Window of a spectrogram, s: long enough to tell a line from its neighbours, short enough for
    a rotor to keep its speed. Made up."""
    stuck: StuckSettings = field(default_factory=StuckSettings)
    noise_level: NoiseLevelSettings = field(default_factory=NoiseLevelSettings)
    vibration: VibrationSettings = field(default_factory=VibrationSettings)
    gust: GustSettings = field(default_factory=GustSettings)


# -- when an equation takes the place of a name --------------------------------------------


@dataclass(frozen=True, slots=True)
class UnnamedSettings(Group):
    """Settings of `twin.explain.unnamed`."""

    most_terms: int = 4
    """Largest number of terms of an equation. Made up."""
    folds: int = 5
    """Number of parts of the time that are left out in turn. Paper: Hastie, Tibshirani & Friedman,
    The Elements of Statistical Learning, sec. 7.10: five or ten."""
    per_term: float = 6.0
    """Log prior odds against one more term, nats. Made up: one of a hundred and more, and its
    coefficient."""
    most_of_it: Share = 0.97
    """Share of the gain of the best equation; the shortest one that reaches it is taken. Made
    up."""
    own_noise_s: float = 0.03
    """Delay of body rates as regressors of a gyroscope channel, s, so that they do not contain the
    noise of the reading. Physics: white noise behind the low-passes of both, 30 Hz to both sides
    and 18 Hz, is correlated by less than 0.01 after so long."""
    tones_hz: Annotated[tuple[float, float], 25.0] = (0.3, 10.0)
    """Band in which a steady oscillation is sought, Hz. Made up."""
    in_band: Share = 0.95
    """Share of the power of an equation that its band contains. Made up."""
    least_share: Share = 0.5
    """Least share of the residual that an equation explains. Physics: less than half explains
    nothing."""
    enough: float = 20.0
    """Least log likelihood gained by equations, nats: many products are tried in many channels.
    Sensitivity: 1 case."""
    covers: Share = 0.4
    """Share of the gain of equations that an effect reaches, from which on it is an imperfect law
    of the right cause: equations are more pliable. Chosen on: large hidden effects
    (docs/results/hidden_effects.md); with 0.7 a gust and an induced inflow got equations."""


# -- gap of held-out flights ---------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class HoldoutSettings(Group):
    """Settings of `twin.explain.holdout`."""

    spared_s: float = 4.0
    """Length of the time blocks that are held out where no flight is, s. Physics: noise of the
    slowest channels lasts a twelfth of it (two periods of POSE_BAND_HZ, 6 Hz)."""
    spared_every: int = 3
    """Number of blocks of which one is held out. Paper: Kohavi, Proc. IJCAI (1995): a third is the
    common share."""
    block_s: float = 1.0
    """Length of the time blocks that the bootstrap of the shrink draws, s. Physics: three times as
    long as noise of the slowest channels lasts."""
    fewest_blocks: int = 5
    """Least number of blocks for an interval of the shrink. Paper: Efron & Tibshirani, An
    Introduction to the Bootstrap (1993), sec. 6: 5 blocks have 126 resamples, 4 only 35."""


# -- all settings --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SearchSettings(Group):
    """All numbers that determine the result of a search, grouped by package of `twin.explain`.

    Attributes:
        usable: Which parts of flights are used.
        inference: Selection of effects and their probabilities.
        stochastic: Selection of zero-mean effects.
        unnamed: When an equation replaces a named effect.
        holdout: Comparison of held-out flights.
    """

    usable: UsableSettings = field(default_factory=UsableSettings)
    inference: InferenceSettings = field(default_factory=InferenceSettings)
    stochastic: StochasticSettings = field(default_factory=StochasticSettings)
    unnamed: UnnamedSettings = field(default_factory=UnnamedSettings)
    holdout: HoldoutSettings = field(default_factory=HoldoutSettings)

    @property
    def changed(self) -> Mapping[str, Value]:
        """Values that differ from the default, by name."""
        usual = {s.name: s.value for s in DEFAULT.every()}
        return {s.name: s.value for s in self.every() if s.value != usual[s.name]}

    @property
    def hash(self) -> str:
        """Hash of all names and values, 12 hexadecimal digits: equal for equal settings of the same
        version."""
        text = "\n".join(f"{s.name} = {s.value!r}" for s in self.every())
        return hashlib.sha256(text.encode()).hexdigest()[:12]


DEFAULT = SearchSettings()
"""Default settings."""
