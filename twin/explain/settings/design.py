"""What to fly next."""

from dataclasses import dataclass

from .group import Group, setting


@dataclass(frozen=True, slots=True)
class DesignSettings(Group):
    """Of `twin.explain.design`."""

    enough: float = setting(
        5.0, "nat", "expected log likelihood below which a manoeuvre separates nothing", "made up"
    )
    hover_m: float = setting(
        1.5,
        "m",
        "height of the hover over the resting place, and unit of the ways; vehicles with short "
        "arms fly everything at half the size, as in missions",
        "made up",
    )
    push: float = setting(
        0.4, "share", "of the acceleration that thrust over weight allows", "made up", 1.0
    )
    fastest_m_s2: float = setting(4.0, "m/s²", "bound of that acceleration", "made up")
    clearance_m: float = setting(
        0.15,
        "m",
        "between legs and ground at least: who reads the log must see that it flies",
        "made up",
    )
    clearance_arms: float = setting(0.7, "arms", "the same, in arm lengths", "made up")
    other_voltage: float = setting(
        0.1,
        "share",
        "of the voltage that lies between a charged and a nearly empty battery",
        "made up",
        1.0,
    )
    payload: float = setting(
        0.5,
        "share",
        "of the vehicle's mass that is strapped on, where thrust allows it",
        "made up: as large as can be, as explanations part by half of that of what they explain "
        "and laws are right to a seventh only; 0.2 at first",
        1.0,
    )
    lightest_payload: float = setting(
        0.02, "share", "of the vehicle's mass that is strapped on at least", "made up", 1.0
    )
    pause_s: float = setting(1.0, "s", "shortest hover after a manoeuvre", "made up")
    settle_s: float = setting(
        6.0,
        "s",
        "hover after the takeoff, in which the controller learns what its model lacks",
        "made up",
    )
