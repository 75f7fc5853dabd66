"""Each page of docs/dev/extending, done as it says: it works, touches what it says, misses nothing.

Everything happens in a copy of the project. A page's steps are taken, its tests and its check run;
then once more without one step, and the project's own tests must say what is missing. What a
command generates from the other steps is left out along with any of them.
"""

import shutil
from collections.abc import Iterator

import pytest
from extending_page import Page, Step, Tree, read_page
from places import ROOT

COPIED = ("twin", "learning", "fmus", "cosim", "uavtwin", "docs", "tests", "pyproject.toml")
PAGES = {p.stem: read_page(p) for p in sorted((ROOT / "docs" / "dev" / "extending").glob("*.md"))}
GOALS = {"effect": 1, "cause": 1, "sensor": 5, "log_format": 3, "compensator_model": 2}
"""Files that each kind of extension may touch."""
STEPS = [
    pytest.param(page, step, id=f"{name}-{step.title}")
    for name, page in PAGES.items()
    for step in page.steps
]
PYTEST = ("-m", "pytest", "-q", "-x", "--no-header", "-p", "no:cacheprovider")
STYLE = ("-m", "ruff")


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Tree:
    """The copy; compiled modules go along, so that unchanged ones are not compiled again."""
    root = tmp_path_factory.mktemp("project")
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, root / name)
        else:
            shutil.copy2(ROOT / name, root / name)
    return Tree(root)


@pytest.fixture
def tree(project: Tree) -> Iterator[Tree]:
    """The copy, as it was again afterwards."""
    yield project
    project.restore()
    assert not project.changed()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_touches_as_few_files_as_it_says(name: str) -> None:
    page = PAGES[name]
    assert len(page.touched) == page.files, sorted(page.touched)
    assert name not in GOALS or page.files <= GOALS[name]


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_a_page_does_what_it_says(name: str, tree: Tree) -> None:
    """All steps: check and tests pass, the tests of the steps too, only docs are generated."""
    page: Page = PAGES[name]
    for step in page.steps:
        tree.take(step)
    generated = tree.changed() - page.touched
    assert all(path.startswith("docs/") for path in generated), sorted(generated)
    written = sorted(p for p in page.touched if p.endswith(".py"))
    for style in (("check",), ("format", "--check")):
        result = tree.run(*STYLE, *style, "--no-cache", *written)
        assert result.returncode == 0, result.stdout + result.stderr
    result = tree.run("-W", "error", "-c", page.check)
    assert result.returncode == 0, result.stdout + result.stderr
    result = tree.run(*PYTEST, *_all_tests(page))
    assert result.returncode == 0, result.stdout[-4000:]


def _all_tests(page: Page) -> list[str]:
    """Those of the page and of its steps in one run; `-k` picks among the former only."""
    of_steps = list(dict.fromkeys(step.test for step in page.steps))
    given = list(page.tests)
    if "-k" in given:
        picked = given.index("-k") + 1
        names = (test.rpartition("/")[2].rpartition("::")[2] for test in of_steps)
        given[picked] = " or ".join([f"({given[picked]})", *names])
    return [*given, *of_steps]


@pytest.mark.long
@pytest.mark.parametrize(("page", "forgotten"), STEPS)
def test_a_forgotten_step_is_found(page: Page, forgotten: Step, tree: Tree) -> None:
    for step in page.steps:
        if step is not forgotten and not step.generates:
            tree.take(step)
    result = tree.run(*PYTEST, forgotten.test)
    said = " ".join(result.stdout.split())
    # 1: a test fails, 2: tests cannot even be collected.
    assert result.returncode in (1, 2), f"nobody misses it: {said[-4000:]}"
    assert forgotten.says in said, said[-4000:]
