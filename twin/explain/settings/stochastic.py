"""Which effects that change no mean."""

from dataclasses import dataclass, field

from ...representation import short_repr
from .group import Group, setting


@dataclass(frozen=True, slots=True)
class StuckSettings(Group):
    """Of `twin.explain.stochastic.search`."""

    shortest_s: float = setting(
        0.5, "s", "shorter stand-stills are lost packets, and harm no fit", "made up"
    )
    longer: float = setting(
        10.0,
        "1",
        "times the longest stand-still that the reading has elsewhere, and its neighbours then",
        "made up",
    )
    moving_bits: float = setting(
        3.0,
        "bits",
        "standard deviation of a neighbour meanwhile, in last bits; less hides in one bit",
        "made up",
    )
    smooth: float = setting(
        0.1,
        "1",
        "second difference over the first below which a signal has no noise to speak of: it may "
        "come to rest, where one with noise never does",
        "made up",
    )


@dataclass(frozen=True, slots=True)
class NoiseLevelSettings(Group):
    """Of `twin.explain.stochastic.imu_noise`."""

    slowest_hz: float = setting(
        80.0,
        "Hz",
        "sample rate from which on the upper half of the band is free of motion",
        "made up",
    )
    bands: tuple[tuple[float, float], ...] = setting(
        ((0.25, 0.33), (0.33, 0.41), (0.41, 0.49)),
        "sample rates",
        "parts of the band that have to agree about the noise",
        "made up: upper half of the band, in three",
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
        "made up",
    )
    alike: float = setting(
        1.25, "1", "largest ratio of two sensors that have the same cause", "made up"
    )


@dataclass(frozen=True, slots=True)
class VibrationSettings(Group):
    """Of `twin.explain.stochastic.imu_noise`."""

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
        "made up",
        1.0,
    )
    smallest_acc_m_s2: float = setting(
        0.02, "m/s²", "rms of a line of the accelerometer that is worth a name", "made up"
    )
    smallest_gyro_rad_s: float = setting(
        0.002, "rad/s", "rms of a line of the gyroscope that is worth a name", "made up"
    )
    line_share: float = setting(
        0.05, "share", "of the power above `from_hz` that a line has at least", "made up", 1.0
    )


@dataclass(frozen=True, slots=True)
class SlowForceSettings(Group):
    """Of `twin.explain.stochastic.gust`."""

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
    folds: int = setting(5, "1", "parts of the time that are left out in turn", "made up")
    floor_hz: tuple[float, float] = setting(
        (5.0, 12.0), "Hz", "where the white floor of the 50 Hz channels is read", "made up", 25.0
    )


@dataclass(frozen=True, slots=True)
class GustSettings(Group):
    """Of `twin.explain.stochastic.gust`."""

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
        "made up",
        1.0,
    )
    unexplained: float = setting(
        0.5, "share", "of the slow power that no curve explains, at least", "made up", 1.0
    )
    smallest_m_s2: float = setting(0.03, "m/s²", "rms of the force that is worth a name", "made up")
    uneven: float = setting(
        6.0,
        "1",
        "largest ratio of the power along x and y: turbulence has no direction to speak of",
        "made up",
    )
    known: float = setting(
        0.35,
        "1",
        "log deviation of the slow power of a complete model from its noise floor",
        "made up",
    )
    lag_s: float = setting(
        0.2, "s", "over which the force is correlated with itself for its time constant", "made up"
    )
    smallest_drag_1_s: float = setting(
        0.02,
        "1/s",
        "below it the model has no drag to speak of, through which a gust could act",
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
    """Of `twin.explain.stochastic`."""

    one_of: float = setting(
        40.0,
        "effects",
        "one of so many is there: its prior odds are one to these",
        "made up: about as many as the library has",
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
