"""Changes in the balance of the rotors since normal flights of the same aircraft.

The causes and their competition are those of `twin.explain.balance`, without a vehicle file: mass
and arm are 1, and the mean commands give the share of the weight on each rotor. The excess of a
rotor's thrust over that in normal flights, about x, y, z and along the thrust, is the change that a
loss of that rotor, or a load at a position, explains.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from ..explain.balance import (
    BALANCED,
    LOAD,
    ROTORS,
    SHAKEN_LEAST_HZ,
    SHAKES_ABOVE_HZ,
    Balance,
    Hypothesis,
    Normal,
    Trim,
    balance_of,
)
from .findings import Findings
from .flight import LEAST_COMMAND, Array, FlightFrame
from .records import Amount, Candidate, Event, NotVisible, Severity

Calm = NDArray[np.bool_]
"""Whether a flight is calm, at each place of its grid."""
THRUST_BY_LEVEL = 2.0
"""Relative thrust per relative motor level, command times voltage: thrust is proportional to the
square of the speed, speed to the voltage at the motor."""
SURE = 0.8
"""Probability from which a cause is named, as in `explain`."""
PLACED = 0.9
"""Probability, among all sets of rotors, from which one is named; below it the change has a size
and no place. Chosen on CrazyPAD's E9."""
SAID = 0.02
"""Smallest probability of a reported alternative."""
MOST_LIFTED = 10.0
"""Thrust over weight of the strongest racing aircraft, in round numbers."""
BEYOND = (
    "the rotors differ from those of the normal flights by more than any loss of thrust or load "
    "explains: are those flights of this aircraft?"
)
"""Text for a larger change."""
LEAST_S = 3.0
"""Shortest calm flight, s."""
SEGMENT = 128
"""Samples of a segment in the spectrum of vibration."""


@dataclass(frozen=True, slots=True)
class Levels:
    """Mean levels of the motors in calm flight.

    Attributes:
        motors: Mean log level of each motor, shape (rotors,).
        volts: Whether the level includes the voltage.
        vibration: Log of the rms acceleration above `SHAKES_ABOVE_HZ`; NaN: not known.
    """

    motors: Array
    volts: bool
    vibration: float


def levels_of(flight: FlightFrame, calm: Calm) -> Levels | None:
    """Levels of a flight; None without commands or calm flight."""
    if flight.drive is None or calm.sum() * flight.dt_s < LEAST_S:
        return None
    command = np.clip(flight.grid[flight.drive][calm], LEAST_COMMAND, None)
    level = np.log(command).mean(axis=0)
    volts = flight.drive == "command" and "vbat" in flight.grid
    if volts:
        level = level + np.log(np.maximum(flight.grid["vbat"][calm, 0], 1e-3)).mean()
    return Levels(level, volts or flight.drive != "command", _shaking(flight, calm))


def _shaking(flight: FlightFrame, calm: Calm) -> float:
    """Log of the rms acceleration above the frequencies of the body's motion, over all axes."""
    rate = flight.rate_hz("acc")
    if rate < SHAKEN_LEAST_HZ:
        return float("nan")
    signal = flight.signals["acc"]
    inside = np.interp(signal.t_s, flight.t_s, calm.astype(float)) > 0.5
    if inside.sum() < SEGMENT:
        return float("nan")
    hz, density = welch(signal.values[inside], rate, nperseg=SEGMENT, axis=0)
    power = float(density[hz >= SHAKES_ABOVE_HZ].sum() * (hz[1] - hz[0]))
    return 0.5 * float(np.log(max(power, 1e-12)))


def changed(
    flight: FlightFrame, calm: Calm, normal_flights: Sequence[tuple[FlightFrame, Calm]]
) -> Findings | None:
    """Changes since normal flights; None: none of these has rotors and calm flight.

    Args:
        flight: Flight with known rotors.
        calm: Mask of controlled flight, high above the ground.
        normal_flights: Normal flights, each with its mask.
    """
    now = levels_of(flight, calm)
    levels = (levels_of(*each) for each in normal_flights)
    normal = [x for x in levels if x and now and len(x.motors) == len(now.motors)]
    if now is None or not normal:
        return None
    usual = np.mean([x.motors for x in normal], axis=0)
    more = float(_more(now.motors - usual).mean())
    found = findings_of(compared(flight, now, normal), "in the normal flights", "1")
    carried = float(np.mean([_carried(r, c) for r, c in normal_flights]))
    sizes = [e.severity.value for e in found.events if e.severity is not None]
    most = min(MOST_LIFTED, 1.0 / carried) - 1.0
    if more <= most and max(sizes, default=0.0) <= max(most, 1.0):
        return found
    return replace(found, events=(), one_of_causes=(), notes=(BEYOND,), undecided=True)


def _carried(flight: FlightFrame, calm: Calm) -> float:
    """Thrust in calm flight over that at full command, by the square of the command: of all motor
    curves it leaves the largest reserve for a load."""
    if flight.drive is None or not calm.any():
        return 1.0
    command = np.clip(flight.grid[flight.drive][calm], LEAST_COMMAND, 1.0)
    return float((command**2).mean())


def findings_of(balance: Balance, usually: str, mass_unit: str) -> Findings:
    """Findings on a change of the balance.

    Args:
        balance: Balance with the causes.
        usually: Time at which the balance was normal, in words.
        mass_unit: Unit of its masses: "kg", or "1" for shares of the aircraft's mass.
    """
    hidden = list(_hidden(balance, mass_unit))
    named = balance.named
    if named is not None:
        event = _event(balance, named, usually, mass_unit)
        return Findings(events=[event], nothing=balance.nothing, not_visible=hidden)
    if balance.one_of:
        placed = LOAD in {h.cause for h in balance.one_of}
        rotors = _rotors(balance) if placed else None
        candidates = [
            Candidate(
                cause=h.cause,
                rotor=rotors if placed else h.rotors or None,
                probability=h.probability,
            )
            for h in balance.one_of
        ]
        candidates.sort(key=lambda c: -c.probability)
        return Findings(one_of_causes=candidates, nothing=balance.nothing, not_visible=hidden)
    undecided = balance.nothing < SURE
    return Findings(nothing=balance.nothing, not_visible=hidden, undecided=undecided)


def _rotors(balance: Balance) -> tuple[int, ...] | None:
    """The rotors that lost thrust, if a rotor did; None: not clear which."""
    best, every = balance.best(ROTORS), balance.probability_of(ROTORS)
    return best.rotors if best.probability >= PLACED * every else None


def compared(flight: FlightFrame, now: Levels, normal: Sequence[Levels]) -> Balance:
    """Causes of a change of levels relative to normal flights."""
    layout = flight.layout
    assert layout is not None
    known = all(x.volts for x in (now, *normal))
    channels = BALANCED if known else BALANCED[1:]
    usual = np.mean([x.motors for x in normal], axis=0)
    hubs = layout.sized(1.0, "").position
    give = np.stack([np.ones(layout.count), hubs[:, 1], -hubs[:, 0], layout.direction])
    give = give[len(BALANCED) - len(channels) :] / layout.count
    means = np.array([give @ _more(x.motors - usual) for x in (now, *normal)])
    names, slopes = _slopes(give, len(channels))
    shaking = np.array([x.vibration for x in (now, *normal)])
    shaken = shaking if np.isfinite(shaking).all() else np.zeros(0)
    trim = Trim(channels, means[:1], slopes, names, shaken[:1])
    before, scatter = Trim(channels, means[1:], slopes, names, shaken[1:]).by_name()
    nothing_else = np.zeros((len(channels), len(channels)))
    return balance_of(
        trim, Normal(len(normal), before, scatter, 1.0, 1.0, hubs, nothing_else), SURE
    )


def _more(change: Array) -> Array:
    """Excess of each rotor's thrust over its normal thrust, by the change of its log level."""
    return np.asarray(np.expm1(THRUST_BY_LEVEL * change))


def _slopes(give: Array, channels: int) -> tuple[tuple[str, ...], Array]:
    """Slopes of the means by the loss of each rotor and by a load, and the names of these
    numbers."""
    losses = tuple(f"{ROTORS}.loss_{i + 1}" for i in range(give.shape[1]))
    load = ("mass_kg", "moment_x_kg_m", "moment_y_kg_m", "moment_z_kg_m")
    of_load = np.zeros((len(BALANCED), len(load)))
    of_load[0, 0], of_load[1, 2], of_load[2, 1] = 1.0, 1.0, -1.0
    slopes = np.hstack([give, of_load[len(BALANCED) - channels :]])
    return (*losses, *(f"{LOAD}.{n}" for n in load)), slopes


def _event(balance: Balance, named: Hypothesis, usually: str, mass_unit: str) -> Event:
    """Event of the named cause."""
    rotors = " and ".join(map(str, named.rotors))
    text = f"It carries a load that it did not carry {usually}"
    check = "Weigh the aircraft; look what was added, and where."
    if named.rotors:
        one, gives = ("Rotor", "gives") if len(named.rotors) == 1 else ("Rotors", "give")
        text = f"{one} {rotors} {gives} less thrust than {usually}"
        check = f"{one} {rotors}: look for cuts and dirt on the propeller, turn the motor."
    return Event(
        cause=named.cause,
        rotor=named.rotors or None,
        severity=_severity(named, mass_unit),
        probability=named.probability,
        alternatives=tuple(_others(balance, named)),
        text=text,
        bench_check=check,
    )


def _severity(named: Hypothesis, mass_unit: str) -> Severity | None:
    """The largest loss, or the mass, of a cause."""
    numbers = [n for n in named.values if "moment" not in n]
    if not numbers:
        return None
    name = max(numbers, key=lambda n: named.values[n])
    value, sd = named.values[name], named.deviations[name]
    quantity, unit = "thrust_lost", "1"
    if named.cause == LOAD:
        quantity, unit = "added_mass" if mass_unit == "kg" else "added_mass_share", mass_unit
    wide = 1.645 * sd
    return Severity(quantity=quantity, value=value, low=value - wide, high=value + wide, unit=unit)


def _others(balance: Balance, named: Hypothesis) -> Iterator[Candidate]:
    """Causes that are not part of the named one."""
    for h in balance.hypotheses:
        part = h.cause == named.cause and {*named.rotors} <= {*h.rotors}
        if not part and h.probability > SAID and h.values:
            yield Candidate(cause=h.cause, rotor=h.rotors or None, probability=h.probability)


def _hidden(balance: Balance, mass_unit: str) -> Iterator[NotVisible]:
    """Smallest change that would be detected in 95 of 100 such flights; of any size where that
    exceeds the whole thrust or weight."""
    for cause, least in balance.detectable.items():
        unit = mass_unit if cause == LOAD else "1"
        value = least.value
        if value is not None and unit == "1" and value > 1.0:
            value = None
        yield NotVisible(
            cause=cause,
            smallest_detectable=Amount(value=value, unit=unit),
            reason="flights of one aircraft differ as much",
        )
