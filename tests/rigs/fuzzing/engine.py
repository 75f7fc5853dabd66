"""Recipes, what came of them, and the child that carries them out."""

import contextlib
import json
import os
import random
import selectors
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Protocol, Self

SECONDS = 10.0
"""Longest that a reader may take, of processor time."""
_PATIENCE_S = 300.0
"""For an answer at all: the input is made in that time, too."""
BYTES = 1 << 30
"""Address space that an input may take beyond what the child had."""

_SMALL = 20_000
"""Bytes below which the size of a base does not matter: what is larger takes longer to read."""

Step = tuple[str, dict[str, Any]]
"""Name of a change and its arguments, as JSON has them."""
Outcome = Literal["refused", "told", "same", "silent", "crash", "killed"]
"""One clear error; a finding more than before; nothing changed; changed and not told; a traceback
or too much memory; too slow, or the process died."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What a reader made of a file: its content as a hash, and all that it warned of."""

    content: str
    told: frozenset[str]


class Kind(Protocol):
    """One kind of file."""

    @property
    def file(self) -> str:
        """Name of an input: a reader may go by how it ends."""
        ...

    visible: frozenset[str]
    """Changes of which a finding is possible, except where their arguments have `still`: silence is
    a fault."""

    def bases(self) -> dict[str, bytes]:
        """Sound files by name."""
        ...

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """A change of a file."""
        ...

    def apply(self, blob: bytes, step: Step) -> bytes:
        """The changed file."""
        ...

    def read(self, path: Path) -> Seen:
        """Read the file as a user would.

        Raises:
            TwinError: It is refused.
        """
        ...


@dataclass(frozen=True, slots=True)
class Recipe:
    """One input, never its bytes: a base and the changes to it."""

    kind: str
    base: str
    steps: tuple[Step, ...]

    def line(self) -> str:
        """As a line of the corpus."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def parse(cls, line: str) -> Self:
        """From a line of the corpus."""
        given = json.loads(line)
        steps = tuple((str(name), dict(arguments)) for name, arguments in given["steps"])
        return cls(given["kind"], given["base"], steps)


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a recipe.

    Attributes:
        outcome: In a word.
        text: The error, the traceback, or what was told.
        visible: Whether a finding was possible.
        recipe: The input.
    """

    outcome: Outcome
    text: str
    visible: bool
    recipe: Recipe

    @property
    def fault(self) -> bool:
        """Whether no reader may ever answer so."""
        return self.outcome in ("crash", "killed")


class Child(contextlib.AbstractContextManager["Child"]):
    """A process that carries out recipes one by one; another where one died."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop()

    def run(self, recipe: Recipe) -> Result:
        """Carry out one recipe."""
        process = self._process or self._start()
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(recipe.line() + "\n")
            process.stdin.flush()
            with selectors.DefaultSelector() as wait:
                wait.register(process.stdout, selectors.EVENT_READ)
                answer = process.stdout.readline() if wait.select(_PATIENCE_S) else ""
        except BrokenPipeError:
            answer = ""
        if not answer:
            self._stop()
            return Result("killed", f"no answer within {SECONDS:.0f} s, or died", True, recipe)
        given = json.loads(answer)
        return Result(given["outcome"], given["text"], given["visible"], recipe)

    def _start(self) -> "subprocess.Popen[str]":
        self._process = subprocess.Popen(
            [sys.executable, "-m", f"{__package__}.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        )
        return self._process

    def _stop(self) -> None:
        if self._process is None:
            return
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
        self._process = None


def recipes(kind_name: str, kind: Kind, seed: int, only: Sequence[str] = ()) -> Iterator[Recipe]:
    """Recipes without end, the same for the same seed; a large base is drawn less often.

    Args:
        kind_name: As in `all_kinds`.
        kind: Of that name.
        seed: Of every draw.
        only: Bases to draw from; none: from all that there are.
    """
    rng = random.Random(seed)
    bases = {k: v for k, v in kind.bases().items() if k in only or not only}
    names = sorted(bases)
    shares = [1.0 / (_SMALL + len(bases[name])) for name in names]
    while True:
        base = rng.choices(names, shares)[0]
        count = 1 if rng.random() < 0.8 else rng.randint(2, 4)
        steps: list[Step] = []
        blob = bases[base]
        for _ in range(count):
            if steps:
                blob = kind.apply(blob, steps[-1])
            steps.append(kind.draw(rng, blob))
        yield Recipe(kind_name, base, tuple(steps))
