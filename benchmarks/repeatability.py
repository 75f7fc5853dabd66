"""Whether the verbs give the same bytes again, and survive being killed.

    python -m benchmarks.repeatability --work out/repeatability --runs 10 --kills 100

Each verb runs so often on built-in flights, with one thread and with two in turn. Then verbs are
killed (SIGKILL) at random moments of their life and run again: every file in the output folder has
to be whole, files of the user have to be as they were, the same command has to give the same files,
and nothing may be left. Ends with 1 where one of this fails.

Verbs that record a live flight are not among them: what they have recorded until a kill is kept.
"""

import argparse
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
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
    """A command, and the folder that it writes into.

    Attributes:
        words: Without `--out`; files are named from the working folder.
        empty: Its folder is there already, empty.
        journal: File of its folder in which it notes what it has done until it ends; "": none.
        codes: With which it may end.
        file: Of its folder, where `--out` names a file; "": it names the folder.
        users: Whether files of the user are in the folder.
    """

    words: tuple[str, ...]
    empty: bool = False
    journal: str = ""
    codes: tuple[int, ...] = (0,)
    file: str = ""
    users: bool = False


_ON = ("--vehicle", "copter_default")
_BOTH = ("one.parquet", "two.parquet", *_ON)
VERBS: Mapping[str, Verb] = {
    "simulate": Verb(
        ("simulate", "hover", "--stop", "0.5", "--fused", "--csv", "--force"), users=True
    ),
    "export": Verb(("export", "barometer")),
    "gap": Verb(("gap", "one.parquet", *_ON), empty=True),
    "convert": Verb(("convert", "one.parquet"), file="made.csv", users=True),
    "draft": Verb(
        ("vehicle", "draft", *_BOTH[:2], "--mass", "1.3kg", "--wheelbase", "480mm"),
        codes=(0, 1),
        file="made.toml",
        users=True,
    ),
    "sweep": Verb(
        ("sweep", "hover", "--vary", "airframe.mass=1.3:1.5", "--runs", "4", "--duration", "0.3"),
        journal="sweep.jsonl",
    ),
    "fleet": Verb(
        ("fleet", *_BOTH, "--verbs", "check,gap", "--workers", "1"),
        journal="fleet.jsonl",
        codes=(0, 1),
    ),
    "train": Verb(("train", *_BOTH, "--epochs", "4"), journal="checkpoint.safetensors"),
    "force": Verb(("train", *_BOTH, "--protocol", "force"), journal="checkpoint.jsonl"),
    "calibrate": Verb(("calibrate", *_BOTH), codes=(0, 1), file="made.toml", users=True),
    "explain": Verb(("explain", *_BOTH), codes=(0, 1)),
    "evaluate": Verb(("evaluate", "compensator", "two.parquet")),
    "generate": Verb(("generate", "generator"), file="made.parquet", users=True),
    "demo": Verb(("demo",), empty=True, codes=(0, 1)),
}
USERS = {"thesis.tex": b"mine", "photos/a.jpg": b"mine", ".uavtwin-notes": b"mine"}
"""Files of the user by their paths."""


def tree(folder: Path) -> dict[str, bytes]:
    """Content of every file by its path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def scratch(path: str) -> bool:
    """Whether a file is of a scratch folder."""
    return path.startswith(".uavtwin-") and path not in USERS


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
            [*PROGRAM, *self.verbs[name].words, "--out", str(Path(name, self.verbs[name].file))],
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
        if self.verbs[name].empty or self.verbs[name].users:
            (self.work / name).mkdir()
        for path, content in USERS.items() if self.verbs[name].users else ():
            place = self.work / name / path
            place.parent.mkdir(exist_ok=True)
            place.write_bytes(content)

    def _clear(self, name: str) -> None:
        """Take away what a verb has finished, since it writes over no results; leave the rest."""
        there = {path for path in tree(self.work / name) if not scratch(path)}
        if there == self.whole[name].keys():
            self.fresh(name)

    def same(self, name: str, threads: int) -> bool:
        """Whether it gives the same files again."""
        self.fresh(name)
        self.finish(name, self.begin(name, threads))
        return tree(self.work / name) == self.whole[name]

    def kill(self, name: str, moment: float, without_cache: bool) -> list[str]:
        """Kill it at a share of its duration; files that are wrong then.

        Every result that is there has to be whole, and all are there if the folder is new; files of
        the user are as they were.
        """
        self._clear(name)
        if without_cache:
            shutil.rmtree(self.cache, ignore_errors=True)
        run = self.begin(name)
        with suppress(subprocess.TimeoutExpired):
            run.wait(self.lasted[name] * moment)
        run.kill()
        run.communicate()
        verb, whole = self.verbs[name], self.whole[name]
        found = {k: v for k, v in tree(self.work / name).items() if not scratch(k)}
        found.pop(verb.journal, None)
        wrong = [path for path, content in found.items() if whole.get(path) != content]
        new = not (verb.empty or verb.journal or verb.users)
        expected = whole.keys() if new and found else USERS.keys() & whole.keys()
        return sorted({*wrong, *(expected - found.keys())})

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
        if wrong := bench.kill(name, moment, without_cache=k % 4 > 1):
            yield f"{name}, killed at {moment:.0%}: {', '.join(wrong)} missing or half-written"
        done(k + 1)
    for name in names:
        if not bench.again(name):
            yield f"{name}: after kills other files than without"
    if left := bench.left():
        yield f"left behind: {', '.join(sorted(left))}"


def write_flights(work: Path) -> None:
    """Two flights with drag that the vehicle file lacks."""
    from twin.logs import write_flight
    from twin.vehicle_file import load_vehicle
    from uavtwin.demo.flights import fly

    vehicle = load_vehicle(_ON[1])
    plant = vehicle.with_effects({"rotor_drag": {"k_xy_1_s": 0.35, "k_z_1_s": 0.2}})
    for seed, name in enumerate(("one", "two"), start=1):
        write_flight(fly(vehicle, plant, seed, name, LEGS), work / f"{name}.parquet")


def write_models(work: Path, verbs: Iterable[str]) -> None:
    """Trained models that verbs read."""
    protocol = ("--protocol", "generate", "--model", "innovations")
    needed = {
        "evaluate": ("--epochs", "2", "--out", "compensator"),
        "generate": (*protocol, "--out", "generator"),
    }
    for name in needed.keys() & set(verbs):
        command = [*PROGRAM, "train", "one.parquet", *_ON, *needed[name]]
        subprocess.run(command, cwd=work, check=True, capture_output=True)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="new folder to work in")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--verbs", nargs="*", choices=VERBS, help="default: all")
    given = parser.parse_args()
    if given.work.exists():
        parser.error(f"{given.work} is there already; give a new folder")
    given.work.mkdir(parents=True)
    verbs = {name: VERBS[name] for name in given.verbs or VERBS}
    write_flights(given.work)
    write_models(given.work, verbs)
    bench, good = Bench(given.work.resolve(), verbs), True
    for name in verbs:
        same = 1 + sum(bench.same(name, threads=1 + k % 2) for k in range(1, given.runs))
        print(f"{name}: {bench.lasted[name]:.0f} s, same bytes {same} of {given.runs}", flush=True)
        good &= same == given.runs
    wrong = list(killed(bench, given.kills, given.seed, lambda k: print(f"\r{k} kills", end="")))
    print(f"\r{given.kills} kills: {'; '.join(wrong) or 'nothing half-written, nothing left'}")
    return 0 if good and not wrong else 1


if __name__ == "__main__":
    raise SystemExit(main())
