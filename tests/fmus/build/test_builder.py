"""Same inputs, same bytes; another input, another token."""

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import fmpy
import pytest
from instance import Instance, token, unzip
from kinds import component, model
from places import IMPORT_PATH

from fmus import build, component_model
from twin.errors import FmuError

FmuFile = Callable[[str, int], Path]


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("kind", "fmi"), [("battery", 2), ("imu", 3), ("replay", 2), ("replay", 3)]
)
def test_two_builds_are_the_same_bytes(
    fmu_file: FmuFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, fmi: int
) -> None:
    """From the cache, compiled anew, and from another working directory."""
    first = sha256(fmu_file(kind, fmi))
    assert sha256(build(model(kind), tmp_path / "again.fmu", fmi)) == first
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "empty"))
    monkeypatch.chdir(tmp_path)
    assert sha256(build(model(kind), Path("elsewhere.fmu"), fmi)) == first
    assert list((tmp_path / "empty").glob("*.so"))


def test_what_is_the_same_is_not_compiled_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One number differs, and with it the tables and the token; or the version of FMI, and with it
    its own file and the token. The library is that from nothing."""
    other = component_model(component("battery").with_starts({"resistance": 0.25}))
    kept: list[int] = []
    first = model("battery")
    for cache, one, fmi in (
        *(("warm", first, 2), ("warm", other, 2), ("warm", first, 3)),
        *(("empty", other, 2), ("clean", first, 3)),
    ):
        monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / cache))
        build(one, tmp_path / f"{len(kept)}.fmu", fmi)
        kept.append(len(list((tmp_path / cache).glob("*.o"))))
    assert kept == [5, 7, 9, 5, 5]
    assert sha256(tmp_path / "1.fmu") == sha256(tmp_path / "3.fmu")
    assert sha256(tmp_path / "2.fmu") == sha256(tmp_path / "4.fmu")


def test_another_process_builds_the_same_bytes(fmu_file: FmuFile, tmp_path: Path) -> None:
    """Another hash seed, another clock, the component written down anew."""
    program = (
        "from pathlib import Path; from kinds import model; from fmus import build; "
        "build(model('airframe-copter_default'), Path('a.fmu'), 3)"
    )
    environment = {
        **os.environ,
        "PYTHONHASHSEED": "4711",
        "PYTHONPATH": IMPORT_PATH,
        "UAVTWIN_CACHE": str(tmp_path / "cache"),
        "TZ": "Asia/Tokyo",
    }
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, check=True)
    assert sha256(tmp_path / "a.fmu") == sha256(fmu_file("airframe-copter_default", 3))


def test_token_follows_the_content(fmu_file: FmuFile, tmp_path: Path) -> None:
    other_start = component_model(component("battery").with_starts({"resistance": 0.25}))
    (part,) = model("replay").parts
    record = {"record.bin": part.resources["record.bin"][:-8] + b"\0" * 8}
    other_data = replace(model("replay"), parts=(replace(part, resources=record),))
    tokens = [
        token(unzip(path, tmp_path / str(i)))
        for i, path in enumerate(
            [
                fmu_file("battery", 2),
                fmu_file("battery", 3),
                build(other_start, tmp_path / "start.fmu", 2),
                fmu_file("replay", 2),
                build(other_data, tmp_path / "data.fmu", 2),
            ]
        )
    ]
    assert len(set(tokens)) == len(tokens)


def test_start_values_keep_every_bit(tmp_path: Path) -> None:
    value = 0.1 + 0.2
    changed = component_model(component("battery").with_starts({"resistance": value}))
    description = fmpy.read_model_description(str(build(changed, tmp_path / "b.fmu", 2)))
    (start,) = [v.start for v in description.modelVariables if v.name == "resistance"]
    assert float(start) == value
    instance = Instance(unzip(tmp_path / "b.fmu", tmp_path / "b")).start()
    assert instance.get("resistance") == value
    instance.close()


def test_refusals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FmuError, match="battery: FMI 1 is not supported; choose 2 or 3"):
        build(model("battery"), tmp_path / "b.fmu", 1)
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "empty"))
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(FmuError, match="No C compiler: CC is 'no-such-compiler', which is not"):
        build(model("battery"), tmp_path / "b.fmu", 2)
    monkeypatch.setenv("CC", "false")
    with pytest.raises(FmuError, match=r"battery: the C compiler failed: .*false"):
        build(model("battery"), tmp_path / "b.fmu", 2)
    assert not list(tmp_path.glob("*.fmu"))
