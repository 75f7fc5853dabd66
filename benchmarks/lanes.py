"""Lanes against the FMU, all outputs: `python -m benchmarks.lanes --designs 1000 --journal J`.

Random aircraft in wind, gusts and noise, a block of lanes at a time: of each block none, a tenth,
half or nine tenths of the effects are on. A journal keeps what was found of each block, so that a
run goes on where it ended; what another FMU or another library left in it does not count.
"""

import argparse
import hashlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct, json

from cosim.lanes import LaneMaster
from cosim.master import Master
from cosim.recording import Recording
from cosim.system import System
from fmus.lanes import LANES, lanes_library
from twin.effects import EFFECTS
from twin.flight.assembly import Assembly, flying_twin
from twin.vehicle_file import load_vehicle
from uavtwin.simulation import Scenario, scenario_system, shaping_starts

VEHICLE = load_vehicle("copter_default")
SHARES = (0.0, 0.1, 0.5, 0.9)
"""Shares of the effects that are on, block after block."""
STEP_S = 0.01
"""Communication step."""


class Compared(Struct, frozen=True):
    """A block.

    Attributes:
        block: Its number, which is the seed of what is drawn.
        key: Hash of the FMU, of the library, and of how long is flown.
        differ: Start values of those whose outputs were not those of the FMU.
    """

    block: int
    key: str
    differ: tuple[dict[str, float], ...]


def switches(twin: Assembly) -> list[str]:
    """Effects that the twin has and an aircraft may have."""
    known = {f"{k}.{v.name}" for k, part in twin.parts.items() for v in part.parameters}
    return [
        name
        for name, effect in EFFECTS.items()
        if effect.of_vehicle and f"{effect.component}.{name}.enabled" in known
    ]


def design(twin: Assembly, rng: np.random.Generator, share: float) -> dict[str, float]:
    """Start values of a random aircraft in wind, gusts and noise, this share of the effects on."""
    effects = [name for name in switches(twin) if rng.random() < share]
    wind = rng.normal(size=3) * [4.0, 4.0, 0.5]
    scenario = Scenario(
        "tour",
        wind_m_s=(float(wind[0]), float(wind[1]), float(wind[2])),
        gusts=bool(rng.random() < 0.8),
        seed=int(rng.integers(10**6)),
        effects=effects,
        starts={"airframe.mass": float(rng.uniform(1.2, 1.8))},
    )
    return {f"twin.{name}": value for name, value in shaping_starts(twin, scenario).items()}


def same(one: Recording, other: Recording) -> bool:
    """All of it, bit by bit."""
    return (one.names, one.time_s.tobytes(), one.values.tobytes()) == (
        other.names,
        other.time_s.tobytes(),
        other.values.tobytes(),
    )


def different(
    twin: Assembly, system: System, blocks: Sequence[int], seconds: float, lanes: int = LANES
) -> Iterator[list[dict[str, float]]]:
    """Of each block the random aircraft whose outputs in a lane are not those of the FMU."""
    several = LaneMaster(system, lanes=lanes)
    with Master(system) as master:
        for block in blocks:
            rng = np.random.default_rng(block)
            starts = [design(twin, rng, SHARES[block % len(SHARES)]) for _ in range(lanes)]
            flown = several.run(starts, 0.0, seconds, STEP_S)
            found = []
            for own, recording in zip(starts, flown, strict=True):
                master.initialize(0.0, own)
                if not same(master.run(seconds, STEP_S), recording):
                    found.append(own)
            yield found


def compared(journal: Path) -> list[Compared]:
    """Blocks in a journal; cuts off a last line that a kill left incomplete."""
    content = journal.read_bytes() if journal.exists() else b""
    whole = content[: content.rfind(b"\n") + 1]
    if whole != content:
        os.truncate(journal, len(whole))
    return [json.decode(line, type=Compared) for line in whole.splitlines()]


def main() -> int:
    """Command line; 1: a lane differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--designs", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=20.0, help="of the tour")
    parser.add_argument("--journal", type=Path, required=True)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        system = scenario_system(Scenario("tour", VEHICLE, fused=True), Path(folder))
        content = system.fmus["twin"].read_bytes() + lanes_library(system.fmus["twin"])
        key = hashlib.sha256(content + repr(given.seconds).encode()).hexdigest()
        known = [c for c in compared(given.journal) if c.key == key]
        count = -(-given.designs // LANES)
        left = sorted({*range(count)} - {c.block for c in known})
        twin = flying_twin(VEHICLE, "tour", "lqr")
        for block, found in zip(left, different(twin, system, left, given.seconds), strict=True):
            known.append(Compared(block, key, tuple(found)))
            with given.journal.open("ab") as file:
                file.write(json.encode(known[-1]) + b"\n")
    differ = [own for c in known for own in c.differ]
    print(f"{LANES * len(known)} designs of {given.seconds:g} s: {len(differ)} differ from the FMU")
    print(*differ, sep="\n", end="\n" if differ else "")
    return 1 if differ else 0


if __name__ == "__main__":
    raise SystemExit(main())
