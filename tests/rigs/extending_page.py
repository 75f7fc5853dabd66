"""Pages of `docs/dev/extending` as programs: the steps they tell a reader, taken in a copy.

A page has a front matter with `files: N`, the number of files that are written by hand, and
`tests: ...`, what pytest is given to try the extension; then headings `## `. Under a heading
stands what is to be done, each line followed by a block of code:

    New file `PATH`:                        the block is its content
    In `PATH`, after the line `LINE`:       the block goes below that line
    In `PATH`, before the line `LINE`:      the block goes above it
    In `PATH`, instead of the line `LINE`:  the block takes its place
    Run:                                    the block is a shell command

and what tells a reader who left it out:

    Without it `TEST` says `TEXT`.

The block under the heading `## Check` is run at the end.
"""

import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

_HEADING = re.compile(r"^## (.+)$", re.MULTILINE)
_BLOCK = r"\n\n```[a-z]+\n(?P<block>.*?)```$"
_EDIT = re.compile(
    r"^(?:New file `(?P<new>[^`\n]+)`"
    r"|In `(?P<path>[^`\n]+)`, (?P<where>after|before|instead of) the line `(?P<line>[^`\n]+)`"
    rf"|(?P<run>Run)):{_BLOCK}",
    re.MULTILINE | re.DOTALL,
)
_FORGOTTEN = re.compile(r"^Without\s+it\s+`([^`]+)`\s+says\s+`([^`]+)`\.$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Edit:
    """One thing that a reader does.

    Attributes:
        path: File, from the root of the project; "" for a command.
        where: `new`, `after`, `before`, `instead of` or `run`.
        line: Line that is there already.
        text: The block.
    """

    path: str
    where: str
    line: str
    text: str


@dataclass(frozen=True, slots=True)
class Step:
    """What stands under one heading.

    Attributes:
        title: The heading.
        edits: In order.
        test: What fails where the step is left out.
        says: And what it says then.
    """

    title: str
    edits: tuple[Edit, ...]
    test: str
    says: str

    @property
    def generates(self) -> bool:
        """Whether it only runs commands."""
        return all(e.where == "run" for e in self.edits)


@dataclass(frozen=True, slots=True)
class Page:
    """A page, read.

    Attributes:
        files: Number of files written by hand, as its front matter has it.
        tests: Arguments of pytest.
        steps: In order.
        check: Program that shows that it worked.
    """

    files: int
    tests: tuple[str, ...]
    steps: tuple[Step, ...]
    check: str

    @property
    def touched(self) -> set[str]:
        """Files that are written by hand."""
        return {e.path for s in self.steps for e in s.edits if e.path}


def read_page(path: Path) -> Page:
    """The page; a step that is not complete, or that nobody would miss, is an error."""
    text = path.read_text("utf-8")
    front = re.match(r"---\nfiles: (\d+)\ntests: (.+)\n---\n", text)
    assert front, f"{path.name}: begins with '---', 'files: N', 'tests: ...', '---'"
    titles = list(_HEADING.finditer(_without_code(text)))
    ends = [t.start() for t in titles[1:]] + [len(text)]
    steps, check = [], ""
    for title, end in zip(titles, ends, strict=True):
        part = text[title.end() : end]
        if title[1] == "Check":
            check = re.findall(r"```python\n(.*?)```", part, re.DOTALL)[0]
        else:
            steps.append(_step(path.name, title[1], part))
    assert check, f"{path.name}: has no '## Check' with a Python block"
    return Page(int(front[1]), tuple(shlex.split(front[2])), tuple(steps), check)


def _without_code(text: str) -> str:
    """The text with its blocks blanked, so that comments in them are no headings."""
    return re.sub(r"^```.*?^```", lambda m: re.sub(r"[^\n]", " ", m[0]), text, flags=re.M | re.S)


def _step(page: str, title: str, part: str) -> Step:
    edits = tuple(_edit(found) for found in _EDIT.finditer(part))
    blocks = len(re.findall(r"^```[a-z]+$", part, re.MULTILINE))
    assert len(edits) == blocks, f"{page}, {title}: {blocks} blocks, {len(edits)} say where they go"
    forgotten = _FORGOTTEN.search(part)
    assert forgotten, f"{page}, {title}: has no 'Without it `TEST` says `TEXT`.'"
    return Step(title, edits, forgotten[1], " ".join(forgotten[2].split()))


def _edit(found: re.Match[str]) -> Edit:
    where = "new" if found["new"] else "run" if found["run"] else found["where"]
    return Edit(found["new"] or found["path"] or "", where, found["line"] or "", found["block"])


class Tree:
    """A copy of the project in which steps are taken and taken back."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._project = self._contents()

    def take(self, step: Step) -> None:
        """Do what the step says."""
        for edit in step.edits:
            path = self.root / edit.path
            if edit.where == "run":
                self._command(edit.text)
            elif edit.where == "new":
                assert not path.exists(), f"{edit.path} is there already"
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(edit.text, "utf-8")
            else:
                path.write_text(_inserted(path.read_text("utf-8"), edit), "utf-8")

    def restore(self) -> None:
        """Undo every step."""
        now = self._contents()
        for path in now.keys() | self._project.keys():
            if path not in self._project:
                path.unlink()
            elif now.get(path) != self._project[path]:
                path.write_bytes(self._project[path])

    def changed(self) -> set[str]:
        """Files that differ from the project's."""
        now = self._contents()
        paths = {p for p in now.keys() | self._project.keys() if now.get(p) != self._project.get(p)}
        return {p.relative_to(self.root).as_posix() for p in paths}

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Python with these arguments in the copy, which comes before any installed project."""
        folders = (self.root, self.root / "tests" / "rigs")
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=self.root,
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(map(str, folders)),
                "PYTHONDONTWRITEBYTECODE": "1",
            },
            capture_output=True,
            text=True,
            timeout=900,
        )

    def _command(self, text: str) -> None:
        """Lines that a shell would run."""
        for line in text.strip().splitlines():
            program, *arguments = shlex.split(line)
            assert program == "python", f"only python is run here: {line}"
            result = self.run(*arguments)
            assert result.returncode == 0, result.stdout + result.stderr

    def _contents(self) -> dict[Path, bytes]:
        return {
            p: p.read_bytes()
            for p in self.root.rglob("*")
            if p.is_file() and "__pycache__" not in p.parts
        }


def _inserted(text: str, edit: Edit) -> str:
    """The text with the block below a line of it, above it, or in its place."""
    lines = text.splitlines(keepends=True)
    places = [k for k, line in enumerate(lines) if line.strip() == edit.line.strip()]
    assert len(places) == 1, f"{edit.path} has the line {edit.line!r} {len(places)} times"
    before, line, after = lines[: places[0]], lines[places[0]], lines[places[0] + 1 :]
    middle = {
        "after": [line, edit.text],
        "before": [edit.text, line],
        "instead of": [edit.text],
    }
    return "".join([*before, *middle[edit.where], *after])
