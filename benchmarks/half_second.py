"""How far a twin is off half a second after it was left alone, in six degrees of freedom, with and
without the moment with which the air turns an aircraft that moves through it.

    python -m benchmarks.half_second --data ../shared/data [--taught 1] [--page PAGE]

NanoBench's Crazyflie, each flight held out once: the numbers of a fixed set of effects are fitted
to others, by the evidence of `explain` and without its search. The place of the battery is the
day's: that of the held-out flight is told by the mean moment of its first seconds in the air, which
are not scored. Its yaw trim, 16 rad/s2 in the helix, is not. Then the twin starts at the measured
state, four times a second, and flies on the recorded commands alone. Nothing is chosen on the
held-out flight.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.real_flights.scenarios import SCENARIOS, read
from twin.effects import EFFECTS
from twin.explain.inference.fit import Problem
from twin.explain.inference.priors import priors_of
from twin.explain.model.model import model_of
from twin.frames import rotation_vector
from twin.logs import Flight
from twin.logs.columns import GYRO, POS, QUAT, VEL
from twin.residuals.aligned import AlignedFlight, align_flight
from twin.residuals.short_horizon import READ, window_ends
from twin.residuals.teacher_forced import GRID_S
from twin.vehicle import Vehicle
from uavtwin.output import output_file

Array = NDArray[np.float64]
Values = Mapping[str, float]
SET = (
    "thrust_scale",
    "motor_lag",
    "inertia_error",
    "cog_offset",
    "rotor_drag",
    "flapping_moment",
)
"""Effects whose numbers are fitted: what every aircraft has, before anything is searched for."""
TRIMS = ("cog_offset.x_m", "cog_offset.y_m")
"""Numbers of a day that a mean moment tells."""
STILL = {"rotor_drag.height_m": 0.0, "flapping_moment.k_n_s": 0.0, "cog_offset.z_m": 0.0}
"""Numbers without which drag attacks at the centre of mass and the air turns nothing."""
HORIZON_S, EVERY_S, TRIM_S = 0.5, 0.25, 10.0
"""How long a twin flies alone, time between two starts, seconds in the air that tell the trim."""
QUANTITIES = ("position, m", "velocity, m/s", "attitude, rad", "rates, rad/s")


def fitted(taught: Sequence[Flight], vehicle: Vehicle) -> dict[str, float]:
    """Numbers of the set, "effect.number", fitted to flights."""
    model = model_of(taught, vehicle, [EFFECTS[e] for e in SET])
    problem = Problem.of(model, priors_of(model))
    return problem.values(problem.start(SET, 1.0).best.x)


def trimmed(flight: Flight, vehicle: Vehicle, values: Values) -> dict[str, float]:
    """The same with the centre of mass with which the first seconds in the air have no mean moment
    in roll and pitch."""
    model = model_of([flight], vehicle, [EFFECTS[e] for e in SET])
    columns = [[n.full for n in model.numbers].index(name) for name in TRIMS]
    (channels,) = model.channels(columns, values)
    own = [c for c in channels if c.name in ("gyro_rate_x", "gyro_rate_y")]
    early = [c.t_s < c.t_s[0] + TRIM_S for c in own]
    left = [c.residual[e].mean() for c, e in zip(own, early, strict=True)]
    slopes = [c.slopes[e].mean(axis=0) for c, e in zip(own, early, strict=True)]
    moved = np.linalg.solve(np.array(slopes), left)
    return {**values, **{n: values[n] + d for n, d in zip(TRIMS, moved, strict=True)}}


def with_numbers(vehicle: Vehicle, values: Values) -> Vehicle:
    """The vehicle with the effects of the set."""
    effects: dict[str, dict[str, float]] = defaultdict(dict)
    for name, value in values.items():
        effect, _, number = name.partition(".")
        if effect in SET:
            effects[effect][number] = value
    return vehicle.with_effects(dict(effects))


def off(predicted: Array, measured: Array) -> Array:
    """Distance of `READ` from the measured one by quantity, shape (w, 4)."""
    at = {names: [READ.index(n) for n in names] for names in (POS, VEL, GYRO, QUAT)}
    pos, vel, rates = (predicted[:, at[n]] - measured[:, at[n]] for n in (POS, VEL, GYRO))
    turned = rotation_vector(predicted[:, at[QUAT]], measured[:, at[QUAT]])
    return np.stack([np.linalg.norm(d, axis=1) for d in (pos, vel, turned, rates)], axis=1)


def measured_at(aligned: AlignedFlight, rows: NDArray[np.intp]) -> Array:
    """`READ` as it was measured."""
    names = [s.name for s in aligned.airframe.states]
    like = [n.replace("gyro_", "omega_") for n in READ]
    return aligned.states[rows][:, [names.index(n) for n in like]]


def last_motion(start: Array) -> Array:
    """`READ` after the horizon where velocity and rates stay; the attitude where it was."""
    later = start.copy()
    pos, vel = ([READ.index(n) for n in names] for names in (POS, VEL))
    later[:, pos] += HORIZON_S * start[:, vel]
    return later


def scores(flight: Flight, vehicle: Vehicle, values: Values) -> Iterator[tuple[str, Array]]:
    """Name of a row, and rms of what it is off after the horizon, shape (4,)."""
    steps = round(HORIZON_S / GRID_S)
    for name, change in (("without the moment of the air", STILL), ("with it", {})):
        numbers = trimmed(flight, vehicle, {**values, **change})
        aligned = align_flight(flight, with_numbers(vehicle, numbers))
        known = aligned.airborne & np.isfinite(aligned.states).all(axis=1)
        first = int(np.flatnonzero(known)[0]) + round(TRIM_S / GRID_S)
        rows = np.arange(first, len(known) - steps, round(EVERY_S / GRID_S), dtype=np.intp)
        rows = rows[np.array([bool(known[r : r + steps + 1].all()) for r in rows])]
        start, end = measured_at(aligned, rows), measured_at(aligned, rows + steps)
        if change:
            yield "last reading", rms(off(start, end))
            yield "last motion", rms(off(last_motion(start), end))
        yield name, rms(off(window_ends(aligned, rows, steps, tail=0)[:, 0], end))


def rms(values: Array) -> Array:
    """Root mean square over windows."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def page(found: Mapping[str, Mapping[str, Array]], told: Mapping[str, Values]) -> str:
    """Tables of all rotations."""
    parts = []
    for held, rows in found.items():
        says = ", ".join(f"`{n}` {v:.3g}" for n, v in told[held].items() if "torque" not in n)
        parts += [f"**{held} held out.** Told by the others: {says}.", ""]
        parts += [f"| 0.5 s alone | {' | '.join(QUANTITIES)} |", "|---|" + "---|" * len(QUANTITIES)]
        parts += [f"| {n} | {' | '.join(f'{v:.3g}' for v in row)} |" for n, row in rows.items()]
        parts.append("")
    return "\n".join(parts)


def main() -> int:
    """Print a table per flight; write them between the marks of a page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--page", type=Path)
    parser.add_argument("--taught", type=int, default=3, help="flights that numbers are fitted to")
    given = parser.parse_args()
    scenario = next(s for s in SCENARIOS if s.title.startswith("NanoBench"))
    vehicle = scenario.read_vehicle()
    flights = [read(given.data, name) for name in scenario.flights]
    found, told = {}, {}
    for held in flights:
        values = fitted([f for f in flights if f is not held][: given.taught], vehicle)
        found[held.name], told[held.name] = dict(scores(held, vehicle, values)), values
        print(page({held.name: found[held.name]}, told), flush=True)
    if given.page:
        head, mark, _ = given.page.read_text("utf-8").partition("<!-- measured -->\n")
        with output_file(given.page) as file:
            file.write_text(head + mark + "\n" + page(found, told), "utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
