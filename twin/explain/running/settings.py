"""The numbers that decide when an alarm is raised; each with unit, meaning and origin."""

from dataclasses import dataclass

from ...representation import short_repr
from ..settings.group import Group, setting

_TUNED = "chosen on: the tuning flights of benchmarks/live_alarms, seeds below 1000"


@dataclass(frozen=True, slots=True)
class RunningSettings(Group):
    """Of `twin.explain.running`."""

    quiet_s: float = setting(
        8.0, "s", "in the air, from which noise and standing offset are learned at first", "made up"
    )
    settle_s: float = setting(1.5, "s", "after the lift-off that count for nothing", "made up")
    forget_s: float = setting(
        120.0, "s", "after which what was learned of the standing model counts a third", "made up"
    )
    standing: float = setting(
        0.5,
        "share",
        "of the prior deviation of a number, by which the standing model may be off",
        "made up: calibrated vehicles are known better than files",
    )
    noise_s: float = setting(20.0, "s", "over which noise levels follow the flight", "made up")
    burst: float = setting(
        4.0, "1", "power over the noise level that counts in full towards it", "made up"
    )
    together: float = setting(
        2.0,
        "1",
        "power of means over two seconds over that of means over a frame, at least: turbulence "
        "lasts about a second, and a quiet start is too short to show it",
        _TUNED,
    )
    level: float = setting(
        4.0, "degrees of freedom", "with which the noise level of a frame is known", "made up"
    )
    tempered: float = setting(
        0.5, "share", "of its samples that a band above the mean counts as", _TUNED, 1.0
    )
    rough: float = setting(
        0.02,
        "share",
        "of the amplitude of a band that no law explains: see EvidenceSettings.rough",
        "as EvidenceSettings.rough",
        1.0,
    )
    floor: float = setting(
        0.5,
        "share",
        "of the constant that a day may bring (EvidenceSettings.trim_*): least deviation of the "
        "mean of a frame",
        _TUNED,
    )
    oldest_s: float = setting(60.0, "s", "ago that a change may have begun at most", "made up")
    every_s: float = setting(1800.0, "s", "between two changes, before anything is seen", "made up")
    bar: float = setting(
        15.0, "nats", "log odds of any change over none from which an alarm is raised", _TUNED
    )
    clear: float = setting(
        0.7, "probability", "of one effect among all from which on it is named at once", _TUNED, 1.0
    )
    patience_s: float = setting(
        3.0, "s", "after which an alarm names the likeliest, and those it may be as well", _TUNED
    )
    settled_s: float = setting(
        15.0,
        "s",
        "after its beginning from which a change belongs to the standing model",
        "made up",
    )
    repeats: int = setting(
        6, "samples", "all the same, from which on a reading is kept out of the evidence", "made up"
    )
    repeat_nats: float = setting(
        0.3, "nats", "for a reading that stands still, of one more sample just as before", "made up"
    )
    least_frames: int = setting(
        2, "frames", "that a change has to last: a bump is over by then", "made up"
    )
    loudest: float = setting(
        30.0, "1", "power over that of the quiet start that counts in full", "made up"
    )
    level_nats: float = setting(
        3.0, "nats", "that a level costs which is estimated, per sub-band that is louder", "made up"
    )
    louder: float = setting(
        2.0, "1", "power over that of the quiet start from which on a shake is one", _TUNED
    )

    __repr__ = short_repr


RUNNING = RunningSettings()
"""As shipped."""
