"""FMUs built once for all tests of this folder."""

from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
from instance import Instance, unzip
from kinds import model

from fmus import build


@pytest.fixture(scope="session")
def fmu_file(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Path]:
    """(kind, FMI version) -> FMU."""
    folder = tmp_path_factory.mktemp("fmus")

    @cache
    def built(kind: str, fmi: int) -> Path:
        return build(model(kind), folder / f"{kind}-{fmi}.fmu", fmi)

    return built


@pytest.fixture(scope="session")
def fmu_folder(
    fmu_file: Callable[[str, int], Path], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str, int], Path]:
    """(kind, FMI version) -> the FMU, extracted; not to be changed."""
    folder = tmp_path_factory.mktemp("extracted")

    @cache
    def extracted(kind: str, fmi: int) -> Path:
        return unzip(fmu_file(kind, fmi), folder / f"{kind}-{fmi}")

    return extracted


@pytest.fixture
def new(fmu_folder: Callable[[str, int], Path]) -> Iterator[Callable[[str, int], Instance]]:
    """(kind, FMI version) -> a fresh instance, freed after the test."""
    made: list[Instance] = []

    def instance(kind: str, fmi: int) -> Instance:
        made.append(Instance(fmu_folder(kind, fmi)))
        return made[-1]

    yield instance
    for one in made:
        one.close()
