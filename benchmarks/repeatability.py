"""Whether the verbs give the same bytes again, and survive being killed.

    python -m benchmarks.repeatability --work out/repeatability --runs 10 --kills 100

Each verb runs so often on built-in flights, with one thread and with two in turn. Then verbs are
killed (SIGKILL) at random moments of their life and run again: nothing half-written may stand in
a new folder, the same command must give the same files, and nothing may be left. Ends with 1 where
one of this fails.
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

PROGRAM = (sys.executable, "-c", "from uavtwin.cli.main import main; main()")
LEGS = (
    ("ground", 0.5, (0.0, 0.0, 0.0)),
    ("takeoff", 2.0, (0.0, 0.0, -1.5)),
    ("hover", 3.0, (0.0, 0.0, -1.5)),
    ("forward", 3.0, (3.0, 1.0, -1.5)),
    ("forward", 3.0, (0.0, 0.0, -1.5)),
)
"""Phase, duration in s, place at its end in m NED."""


@dataclass(frozen=True, slots=True)
class Verb:
    """A command whose `--out` is a folder.

    Attributes:
        words: Without `--out`; files are named from the working folder.
        empty: Its folder is there already, empty.
        resumes: What it has done so far stands in its folder until it ends.
        codes: With which it may end.
    """

    words: tuple[str, ...]
    empty: bool = False
    resumes: bool = False
    codes: tuple[int, ...] = (0,)


_ON = ("--vehicle", "copter_default")
VERBS: Mapping[str, Verb] = {
    "simulate": Verb(("simulate", "hover", "--stop", "0.5", "--fused")),
    "export": Verb(("export", "barometer")),
    "gap": Verb(("gap", "one.parquet", *_ON), empty=True),
    "train": Verb(
        ("train", "one.parquet", "two.parquet", *_ON, "--epochs", "4"),
        resumes=True,
    ),
    "explain": Verb(("explain", "one.parquet", "two.parquet", *_ON), codes=(0, 1)),
    "evaluate": Verb(("evaluate", "compensator", "two.parquet")),
}


def tree(folder: Path) -> dict[str, bytes]:
    """Content of every file by its path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


class Bench:
    """A working folder in which verbs run, each into the folder of its name.

    Args:
        work: With the files that the verbs read.
        verbs: By name.
    """

    def __init__(self, work: Path, verbs: Mapping[str, Verb]) -> None:
        self.work, self.verbs = work, verbs
        self.temporary, self.cache = work / "temporary", work / "cache"
        self.whole: dict[str, dict[str, bytes]] = {}
        self.lasted: dict[str, float] = {}
        self.temporary.mkdir()
        self.read = {p.name for p in work.iterdir()}
        for name in verbs:
            self.fresh(name)
            begun = time.monotonic()
            self.finish(name, self.begin(name))
            self.lasted[name] = time.monotonic() - begun
            self.whole[name] = tree(work / name)

    def begin(self, name: str, threads: int = 1) -> subprocess.Popen[bytes]:
        """The verb as a process, with a temporary folder and a cache that suffer with it."""
        count = str(threads)
        places = {"TMPDIR": str(self.temporary), "UAVTWIN_CACHE": str(self.cache)}
        many = {"OMP_NUM_THREADS": count, "OPENBLAS_NUM_THREADS": count}
        return subprocess.Popen(
            [*PROGRAM, *self.verbs[name].words, "--out", name],
            cwd=self.work,
            env={**os.environ, **places, **many},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )

    def finish(self, name: str, run: subprocess.Popen[bytes]) -> None:
        """Wait for it; what it says where it fails is raised."""
        _, told = run.communicate()
        if run.returncode not in self.verbs[name].codes:
            raise AssertionError(f"{name} ended with {run.returncode}: {told.decode()}")

    def fresh(self, name: str) -> None:
        """Its folder as before the first run."""
        shutil.rmtree(self.work / name, ignore_errors=True)
        if self.verbs[name].empty:
            (self.work / name).mkdir()

    def _clear(self, name: str) -> None:
        """Take away what a verb has finished, since it writes over no results; leave the rest."""
        if tree(self.work / name).keys() == self.whole[name].keys():
            self.fresh(name)

    def same(self, name: str, threads: int) -> bool:
        """Whether it gives the same files again."""
        self.fresh(name)
        self.finish(name, self.begin(name, threads))
        return tree(self.work / name) == self.whole[name]

    def kill(self, name: str, moment: float, without_cache: bool) -> bool:
        """Kill it at a share of its duration; whether a new folder is whole or not there."""
        self._clear(name)
        if without_cache:
            shutil.rmtree(self.cache, ignore_errors=True)
        run = self.begin(name)
        with suppress(subprocess.TimeoutExpired):
            run.wait(self.lasted[name] * moment)
        run.kill()
        run.communicate()
        verb, folder = self.verbs[name], self.work / name
        told = folder.is_dir() and not verb.empty and not verb.resumes
        return not told or tree(folder) == self.whole[name]

    def again(self, name: str) -> bool:
        """Whether the same command works after kills, to the same files."""
        self._clear(name)
        self.finish(name, self.begin(name, threads=2))
        return tree(self.work / name) == self.whole[name]

    def left(self) -> set[str]:
        """Names of files that no verb was asked for."""
        places = (self.work, self.cache, self.temporary)
        there = {p.name for place in places if place.is_dir() for p in place.iterdir()}
        hidden = {n for n in there if n.startswith((".", "uavtwin"))}
        own = {*self.read, *self.verbs, self.temporary.name, self.cache.name}
        unasked = {p.name for p in self.work.iterdir()} - own
        return hidden | unasked | {p.name for p in self.temporary.iterdir()}


def killed(bench: Bench, kills: int, seed: int, done: Callable[[int], None]) -> Iterator[str]:
    """Kill the verbs in turn at random moments, then run each again; yields what is wrong."""
    clock, names = random.Random(seed), list(bench.verbs)
    for name in names:
        bench.fresh(name)
    for k in range(kills):
        name, moment = names[k % len(names)], clock.uniform(0.2, 1.05)
        if not bench.kill(name, moment, without_cache=k % 4 > 1):
            yield f"{name}, killed at {moment:.0%}: half-written"
        done(k + 1)
    for name in names:
        if not bench.again(name):
            yield f"{name}: after kills other files than without"
    if left := bench.left():
        yield f"left behind: {', '.join(sorted(left))}"


def write_flights(work: Path) -> None:
    """Two flights with drag that the vehicle file lacks."""
    from twin.logs import write_flight
    from twin.vehicle.file import load_vehicle
    from uavtwin.demo.flights import fly

    vehicle = load_vehicle(_ON[1])
    plant = vehicle.with_effects({"rotor_drag": {"k_xy_1_s": 0.35, "k_z_1_s": 0.2}})
    for seed, name in enumerate(("one", "two"), start=1):
        write_flight(fly(vehicle, plant, seed, name, LEGS), work / f"{name}.parquet")


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="new folder to work in")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    given = parser.parse_args()
    if given.work.exists():
        parser.error(f"{given.work} is there already; give a new folder")
    given.work.mkdir(parents=True)
    write_flights(given.work)
    model = ("train", "one.parquet", *_ON, "--epochs", "2", "--out", "compensator")
    subprocess.run([*PROGRAM, *model], cwd=given.work, check=True, capture_output=True)
    bench, good = Bench(given.work.resolve(), VERBS), True
    for name in VERBS:
        same = 1 + sum(bench.same(name, threads=1 + k % 2) for k in range(1, given.runs))
        print(f"{name}: {bench.lasted[name]:.0f} s, same bytes {same} of {given.runs}", flush=True)
        good &= same == given.runs
    wrong = list(killed(bench, given.kills, given.seed, lambda k: print(f"\r{k} kills", end="")))
    print(f"\r{given.kills} kills: {'; '.join(wrong) or 'nothing half-written, nothing left'}")
    return 0 if good and not wrong else 1


if __name__ == "__main__":
    raise SystemExit(main())
