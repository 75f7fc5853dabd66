"""Numbers that determine the result of a search, in one frozen object, `SearchSettings`.

Every number has a unit, a meaning and an origin; `docs/reference/settings.md` lists them. The
object is created once and passed down: a function takes only the group of its own package.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field

from ..representation import short_repr
from ..vehicle import GRAVITY_M_S2
from .setting_group import Group, Value, setting

_CHANGES = "sensitivity: halved and doubled it changes no step of a search in the "  # origin
_IN_FIVE = _CHANGES + "5 cases that ask for it (docs/results/sensitivity.md)"  # origin
_IN_ONE = _CHANGES + "case that asks for it (docs/results/sensitivity.md)"  # origin
_FOLDS = (
    "paper: Hastie, Tibshirani & Friedman, The Elements of Statistical Learning, sec. 7.10: "
    "five or ten"
)
"""Origins that several settings share; the number of cases is in the page."""

# -- which flights are fit for a search ----------------------------------------------------


@dataclass(frozen=True, slots=True)
class UsableSettings(Group):
    """Settings of `twin.explain.usable`."""

    shortest_s: float = setting(3.0, "s", "time in the air at least", _IN_FIVE)
    longest_s: float = setting(
        240.0,
        "s",
        "of a longer flight the part of this length is read in which it moves most",
        "made up: is searched in a minute",
    )
    impact_m_s2: float = setting(
        5 * GRAVITY_M_S2,
        "m/s²",
        "specific force, low-passed, that no flight reaches but a blow does",
        _IN_FIVE,
    )
    impact_hz: float = setting(
        20.0,
        "Hz",
        "low-pass of that force",
        "physics: the body moves below it and rotors vibrate above, as for BAND_HZ of "
        "twin.residuals.channels",
    )
    around_s: float = setting(
        1.0,
        "s",
        "left out before and after a blow, and beside the upright ends of a fall",
        _IN_FIVE,
    )
    upside_down_s: float = setting(0.2, "s", "upside down for longer is a crash", "made up")
    tipped_cos: float = setting(
        0.5,
        "1",
        "cosine of the tilt in the last second under which it lies on its side",
        "physics: beyond 60 degrees level flight takes more than twice the weight in thrust",
        1.0,
    )
    latest_s: float = setting(
        0.5,
        "s",
        "attitude and gyroscope may be apart by so much: a delay is an effect like others",
        "physics: a reading of the IMU may be 0.2 s late and a clock 0.25 s off "
        "(twin.effects.timing), together less",
    )
    slow_hz: float = setting(
        1.0, "Hz", "velocity and position are compared below this frequency", "made up"
    )
    slowest_m_s: float = setting(
        0.2,
        "m/s",
        "rms of the velocity from which on they are compared",
        "data sheet: four times the noise of a u-blox NEO-M8's velocity, 0.05 m/s, which takes 3 % "
        "of a correlation then",
    )
    same_motion: float = setting(
        0.5,
        "1",
        "correlation from which on two signals are the same motion in the same axes",
        "physics: halfway between 0, which exchanged axes have, and 1",
        1.0,
    )


# -- which effects, with which probabilities -----------------------------------------------


@dataclass(frozen=True, slots=True)
class LikelihoodSettings(Group):
    """Settings of `twin.explain.inference.whitening`: noise of a channel, for equations and
    designs."""

    order: int = setting(
        15,
        "samples",
        "order of the autoregression that is the noise of a channel",
        "physics: noise behind a second-order low-pass of 6 Hz, that of the slowest channels, is "
        "correlated by less than 0.0005 after 15 samples of 50 Hz",
    )
    block_s: float = setting(
        2.0,
        "s",
        "blocks of time that are left out of a fit, and drawn in the bootstrap",
        "physics: six times as long as noise of the slowest channels lasts (two periods of "
        "POSE_BAND_HZ, 6 Hz), for blocks that do not depend on each other",
    )
    huber: float = setting(
        4.0,
        "sd",
        "innovations beyond so many standard deviations weigh less: a bump, a lost packet",
        "physics: normal innovations at 50 Hz pass it once in five minutes; the weight itself is "
        "that of Huber, Ann. Math. Stat. 35 (1964)",
    )
    roughness: float = setting(
        1e-3,
        "share",
        "of the unexplained power that is added as white noise, as no model is exact: without it "
        "a smooth residual would count as known to many more digits than it is",
        "made up",
        1.0,
    )


@dataclass(frozen=True, slots=True)
class EvidenceSettings(Group):
    """Settings of `twin.explain.inference.evidence`: prior knowledge of the noise."""

    level: float = setting(
        2.0,
        "degrees of freedom",
        "with which the noise level of a band is known",
        "physics: with two the Student t that comes of it has a mean and no variance, with one not "
        "even that",
    )
    samples: float = setting(
        250.0,
        "samples",
        "that a channel of one flight counts as, however fast it was logged",
        "chosen on: RflySimDT real flights and NanoBench; 100 and 600 keep the names",
    )
    rough: float = setting(
        0.02,
        "share",
        "of the amplitude of a band that no law explains, being inexact",
        "chosen on: RflySimDT real flights and NanoBench",
        1.0,
    )
    trim_force: float = setting(
        0.01,
        "share",
        "of gravity: constant specific force that a day brings",
        "chosen on: RflySimDT real flights; three times as much loses the centre of mass",
    )
    trim_turn: float = setting(
        0.0025,
        "share",
        "of the weight at the arm: constant moment about x and y that a day brings",
        "chosen on: RflySimDT real flights; three times as much loses the centre of mass",
    )
    trim_yaw: float = setting(0.3, "share", "of that, about z", "chosen on: RflySimDT real flights")
    trim_pose: float = setting(
        0.005,
        "share",
        "of gravity, and of 0.4 rad/s: constants between pose and IMU that a day brings",
        "made up: 0.3 degrees of levelling, 0.1 deg/s",
    )
    trim_other: float = setting(
        0.02, "share", "of the size of a sensor: constant of it that a day brings", "made up"
    )


@dataclass(frozen=True, slots=True)
class SelectionSettings(Group):
    """Settings of `twin.explain.inference.selection`: probabilities from which on an effect is
    named."""

    sure: float = setting(0.8, "probability", "from which on a name is given", "made up", 1.0)
    moved: float = setting(
        3.0,
        "1",
        "factor on the odds of an effect from which on flights speak for it",
        "paper: Kass & Raftery, J. Am. Stat. Assoc. 90 (1995): up to it evidence is not worth more "
        "than a bare mention",
    )
    credible: float = setting(
        0.5,
        "probability",
        "that the cause is of the library at all, from which on a name is given",
        "physics: more likely than not",
        1.0,
    )
    least: float = setting(
        0.05,
        "probability",
        "below which a hypothesis or an effect is no candidate",
        "paper: one in twenty, the convention of Fisher, Statistical Methods for Research Workers "
        "(1925)",
        1.0,
    )
    variance_per_effect: float = setting(
        1.0,
        "variances",
        "of a number that each reported effect adds to it: no law is exact, and what one of "
        "them gets wrong the numbers of the others make up for",
        "chosen on: half of the cases of benchmarks/hidden_effects as in life "
        "(docs/results/hidden_effects.md); 0.5 is too few there, 1.5 and 2 do as well",
    )


@dataclass(frozen=True, slots=True)
class AdequacySettings(Group):
    """Settings of `twin.explain.inference.selection`: credibility of a named effect."""

    law: float = setting(
        1 / 7,
        "share",
        "deviation of a law of the right name from nature's, of what it explains",
        "measured: right names leave 0.14 or less in 25 of 26 cases "
        "(docs/results/hidden_effects.md)",
        1.0,
    )
    power: float = setting(
        0.07,
        "1",
        "deviation of the power of what an effect of the right name does from that of its law",
        "measured: rms of 0.05 in 31 right names whose power is known to 0.06 "
        "(docs/results/hidden_effects.md)",
    )
    powers: float = setting(
        0.5,
        "1",
        "the same of a law of another cause: by so much the next ones differ",
        "physics: a drag with the third power of a speed is the power 3/2 of one with the second, "
        "and rotor speed the power 1/2 of thrust",
    )
    outside: float = setting(
        0.1, "probability", "prior, that a cause is none of the library", "made up", 1.0
    )
    chance: float = setting(
        2.0,
        "sd",
        "by which what is left has to stand out of noise",
        "physics: mere noise, if normal, stands out by more once in 44",
    )
    memory: float = setting(
        2.0,
        "periods",
        "of the highest frequency of a channel, in which its noise is forgotten",
        "physics: noise behind a second-order Butterworth low-pass is correlated by less than "
        "0.0002 after so long",
    )
    most: int = setting(
        4, "effects", "of a model that lacks more, what one law leaves is not to be told", _IN_FIVE
    )


@dataclass(frozen=True, slots=True)
class InferenceSettings(Group):
    """Settings of `twin.explain.inference`."""

    likelihood: LikelihoodSettings = field(default_factory=LikelihoodSettings)
    evidence: EvidenceSettings = field(default_factory=EvidenceSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    adequacy: AdequacySettings = field(default_factory=AdequacySettings)

    __repr__ = short_repr


# -- effects that change no mean -----------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StuckSettings(Group):
    """Settings of `twin.explain.stochastic.search` for stuck readings."""

    shortest_s: float = setting(
        0.5, "s", "shorter stand-stills are lost packets, and harm no fit", _IN_FIVE
    )
    longer: float = setting(
        10.0,
        "1",
        "times the longest stand-still that the reading has elsewhere, and its neighbours then",
        "physics: by chance lengths fall exponentially, the longest of n is about ln n, and ten "
        "times that comes once in n^9",
    )
    moving_bits: float = setting(
        3.0,
        "bits",
        "standard deviation of a neighbour meanwhile, in last bits; less hides in one bit",
        "physics: a reading with normal steps of 3 bits repeats itself by chance once in 7.5 "
        "samples, ten times running less than once in 10^8",
    )
    smooth: float = setting(
        0.1,
        "1",
        "second difference over the first below which a signal has no noise to speak of: it may "
        "come to rest, where one with noise never does",
        _IN_ONE,
    )


@dataclass(frozen=True, slots=True)
class NoiseLevelSettings(Group):
    """Settings of `twin.explain.stochastic.imu_noise` for noise levels."""

    slowest_hz: float = setting(
        80.0,
        "Hz",
        "sample rate from which on the upper half of the band is free of motion",
        "physics: the first of `bands` begins at 20 Hz then, above the 18 Hz up to which the body "
        "moves (BAND_HZ of twin.residuals.channels)",
    )
    bands: tuple[tuple[float, float], ...] = setting(
        ((0.25, 0.33), (0.33, 0.41), (0.41, 0.49)),
        "sample rates",
        "parts of the band that have to agree about the noise",
        "physics: upper half of what a sample rate can hold, in three equal parts",
        0.5,
    )
    low: float = setting(
        0.2, "1", "quantile of the cells that lines which wander about leave alone", "made up", 1.0
    )
    flat: float = setting(
        1.3,
        "1",
        "largest ratio of the noise in two parts of the band: force of the air falls by more",
        "made up",
    )
    known: float = setting(
        0.08,
        "1",
        "log deviation of the noise that a vehicle file gives from that of a reading",
        "made up",
    )
    ratios: tuple[float, float] = setting(
        (0.1, 30.0),
        "1",
        "a ratio to the noise of the file beyond is no noise level: no noise, or another unit",
        _IN_FIVE,
    )
    alike: float = setting(
        1.25,
        "1",
        "largest ratio of two sensors that have the same cause",
        "physics: two readings that deviate by `known` each differ by less in 95 of 100, exp(1.96 "
        "√2 0.08)",
    )


@dataclass(frozen=True, slots=True)
class VibrationSettings(Group):
    """Settings of `twin.explain.stochastic.imu_noise` for vibration."""

    from_hz: float = setting(
        25.0, "Hz", "below it the body moves and controllers oscillate", "made up"
    )
    neighbours: float = setting(
        0.12,
        "sample rates",
        "half width of what counts as the neighbourhood of a line",
        "made up",
        0.5,
    )
    overlap: float = setting(
        0.6,
        "1",
        "independent windows per window, for Hann windows that overlap by a half",
        "paper: Welch, IEEE Trans. Audio Electroacoustics 15 (1967)",
        1.0,
    )
    line_bins: int = setting(
        6, "bins", "on either side that belong to a line that wanders", "made up"
    )
    motion_share: float = setting(
        0.25,
        "share",
        "of the power of a line; where the twin predicts that much, it is motion",
        _IN_ONE,
        1.0,
    )
    smallest_acc_m_s2: float = setting(
        0.02,
        "m/s²",
        "rms of a line of the accelerometer that is worth a name",
        "data sheet: what an accelerometer of 150 µg/√Hz, as the Bosch BMI055, has of noise within "
        "200 Hz",
    )
    smallest_gyro_rad_s: float = setting(
        0.002,
        "rad/s",
        "rms of a line of the gyroscope that is worth a name",
        "data sheet: four fifths of what a gyroscope of 0.01 °/s/√Hz, as the InvenSense MPU-6500, "
        "has of noise within 200 Hz",
    )
    line_share: float = setting(
        0.05, "share", "of the power above `from_hz` that a line has at least", _IN_ONE, 1.0
    )


@dataclass(frozen=True, slots=True)
class SlowForceSettings(Group):
    """Settings of `twin.explain.stochastic.search` for the slow random force."""

    band_hz: tuple[float, float] = setting(
        (0.1, 3.0), "Hz", "the slow part of the accelerometer residuals", "made up", 5.0
    )
    window_s: float = setting(
        8.0,
        "s",
        "of the spectrum of the slow part; shorter pieces of flight are left out",
        "physics: a Hann window of 8 s resolves 0.25 Hz, which tells a load from turbulence",
    )
    fold_s: float = setting(
        4.0, "s", "blocks of time that a regression predicts from the others", "made up"
    )
    folds: int = setting(5, "1", "parts of the time that are left out in turn", _FOLDS)
    floor_hz: tuple[float, float] = setting(
        (5.0, 12.0),
        "Hz",
        "where the white floor of the 50 Hz channels is read",
        "physics: above the slow part, and where the low-pass of 18 Hz takes less than a sixth of "
        "the power",
        25.0,
    )


@dataclass(frozen=True, slots=True)
class GustSettings(Group):
    """Settings of `twin.explain.stochastic.search` for gusts."""

    slope_bands_hz: tuple[tuple[float, float], ...] = setting(
        ((0.15, 0.35), (0.4, 0.8), (0.8, 1.5), (1.5, 3.0)),
        "Hz",
        "the density of turbulence falls from each to the next; that of a line or load does not",
        "made up",
        5.0,
    )
    smallest_fall: float = setting(
        0.7,
        "1",
        "density of each of these bands over the next, at least; equal ones differ so by chance",
        "made up",
    )
    lasting_s: float = setting(2.0, "s", "blocks of time whose power is compared", "made up")
    lasting: float = setting(
        0.25,
        "1",
        "median over mean of the power of these blocks: turbulence goes on, bumps do not",
        _IN_ONE,
        1.0,
    )
    unexplained: float = setting(
        0.5,
        "share",
        "of the slow power that no curve explains, at least",
        "physics: more than half of it",
        1.0,
    )
    smallest_m_s2: float = setting(0.03, "m/s²", "rms of the force that is worth a name", _IN_ONE)
    uneven: float = setting(
        6.0,
        "1",
        "largest ratio of the power along x and y: turbulence has no direction to speak of",
        _IN_ONE,
    )
    known: float = setting(
        0.35,
        "1",
        "log deviation of the slow power of a complete model from its noise floor",
        "made up",
    )
    typical_drag_1_s: float = setting(
        0.25,
        "1/s",
        "drag over mass and speed where the model has none",
        "paper: Faessler, Franchi & Scaramuzza, IEEE Robotics and Automation Letters 3 (2018): "
        "0.2 to 0.4",
    )


@dataclass(frozen=True, slots=True)
class StochasticSettings(Group):
    """Settings of `twin.explain.stochastic`."""

    one_of: float = setting(
        40.0,
        "effects",
        "one of so many is there: its prior odds are one to these",
        "physics: about as many as the library has, 42; beforehand none of them is likelier",
    )
    line_window_s: float = setting(
        0.5,
        "s",
        "of a spectrogram: long enough to tell a line from its neighbours, short enough for a "
        "rotor to keep its speed",
        "made up",
    )
    stuck: StuckSettings = field(default_factory=StuckSettings)
    noise_level: NoiseLevelSettings = field(default_factory=NoiseLevelSettings)
    vibration: VibrationSettings = field(default_factory=VibrationSettings)
    slow_force: SlowForceSettings = field(default_factory=SlowForceSettings)
    gust: GustSettings = field(default_factory=GustSettings)

    __repr__ = short_repr


# -- when an equation takes the place of a name --------------------------------------------


@dataclass(frozen=True, slots=True)
class UnnamedSettings(Group):
    """Settings of `twin.explain.unnamed`."""

    most_terms: int = setting(4, "terms", "of an equation at most", "made up")
    folds: int = setting(5, "1", "parts of the time that are left out in turn", _FOLDS)
    per_term: float = setting(
        6.0,
        "nat",
        "log prior odds against one more term",
        "made up: one of a hundred and more, and its coefficient",
    )
    most_of_it: float = setting(
        0.97,
        "share",
        "of what the best equation gains; the shortest one that gains that much is taken",
        "made up",
        1.0,
    )
    own_noise_s: float = setting(
        0.03,
        "s",
        "by which turning rates are late where they stand for a gyroscope channel: the noise of "
        "the reading, low-passed to both sides, is not in them any more",
        "physics: white noise behind the low-passes of both, 30 Hz to both sides and 18 Hz, is "
        "correlated by less than 0.01 after so long",
    )
    tones_hz: tuple[float, float] = setting(
        (0.3, 10.0), "Hz", "where a steady shaking is looked for", "made up", 25.0
    )
    in_band: float = setting(
        0.95, "share", "of the power of an equation that its band holds", "made up", 1.0
    )
    least_share: float = setting(
        0.5,
        "share",
        "of what is there; an equation that explains less explains nothing",
        "physics: less than half of it",
        1.0,
    )
    enough: float = setting(
        20.0,
        "nat",
        "log likelihood below which equations say nothing: many products are tried in many "
        "channels",
        _IN_ONE,
    )
    covers: float = setting(
        0.4,
        "share",
        "of what an equation explains; an effect that covers it is an imperfect law of the right "
        "cause: laws of nature are finer than those of a library, and equations more pliable",
        "chosen on: large hidden effects, where with 0.7 a gust and an induced inflow, which "
        "covers 0.45, got equations (docs/results/hidden_effects.md)",
        1.0,
    )


# -- gap of held-out flights ---------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class HoldoutSettings(Group):
    """Settings of `twin.explain.holdout`."""

    spared_s: float = setting(
        4.0,
        "s",
        "block of time that is held out where no flight is",
        "physics: noise of the slowest channels lasts a twelfth of it (two periods of "
        "POSE_BAND_HZ, 6 Hz), so that little of a block depends on what is fitted",
    )
    spared_every: int = setting(
        3,
        "blocks",
        "one in so many is held out",
        "paper: Kohavi, Proc. IJCAI (1995): a third is the common share",
    )
    block_s: float = setting(
        1.0,
        "s",
        "blocks of time that the bootstrap of the shrink draws",
        "physics: three times as long as noise of the slowest channels lasts (two periods of "
        "POSE_BAND_HZ, 6 Hz), for blocks that do not depend on each other",
    )
    fewest_blocks: int = setting(
        5,
        "blocks",
        "with fewer the shrink has no interval",
        "paper: Efron & Tibshirani, An Introduction to the Bootstrap (1993), sec. 6: 5 blocks have "
        "126 different resamples, 4 have 35, too few for the 2.5 % that an end of the interval "
        "cuts off",
    )


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

    __repr__ = short_repr

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
