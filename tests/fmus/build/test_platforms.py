"""Other platforms by zig: right format, same bytes twice, same numbers on each of them.

The first build of win64 on a machine compiles the C runtime of mingw, some minutes; later ones and
the other platforms do not need it. What runs foreign binaries comes with `make cross-tools`.
"""

import hashlib
import importlib.util
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
import pytest
from instance import Instance, library, token, unzip
from kinds import component, model
from places import HOST_SOURCE, needs

from fmus import build
from fmus.platforms import PLATFORMS, select_platforms, universal_binary
from twin.errors import FmuError

FmuPath = Callable[[str, int], Path]
HEADERS = Path(fmpy.__file__).parent / "c-code"
STEPS = 10_000
ARM_LIBRARIES = Path("/usr/aarch64-linux-gnu")
KINDS = [
    ("airframe-copter_default", 2),
    ("airframe-crazyflie", 2),
    ("imu", 2),
    ("battery", 3),
    ("replay", 2),
]


needs_zig = needs(
    importlib.util.find_spec("ziglang") is not None, "no ziglang: pip install ziglang"
)
needs_qemu = needs(
    bool(shutil.which("qemu-aarch64")) and ARM_LIBRARIES.is_dir(),
    "no qemu-aarch64 with libraries of ARM: make cross-tools",
)
needs_wine = needs(bool(shutil.which("wine")), "no wine: make cross-tools")


@pytest.fixture(scope="session")
def everywhere(tmp_path_factory: pytest.TempPathFactory) -> FmuPath:
    """(kind, FMI version) -> FMU for all platforms, extracted; not to be changed."""
    folder = tmp_path_factory.mktemp("everywhere")

    @cache
    def extracted(kind: str, fmi: int) -> Path:
        path = build(model(kind), folder / f"{kind}-{fmi}.fmu", fmi, ["all"])
        return unzip(path, folder / f"{kind}-{fmi}")

    return extracted


def binary(folder: Path, fmi: int, platform: str) -> Path:
    p = PLATFORMS[platform]
    (found,) = (folder / "binaries" / p.folders[fmi]).glob(f"*{p.suffix}")
    return found


# -- formats --------------------------------------------------------------------------------


def mach_exports(content: bytes) -> set[str]:
    """Exported symbols of a Mach-O library of one architecture."""
    commands, at = struct.unpack_from("<I", content, 16)[0], 32
    for _ in range(commands):
        kind, size = struct.unpack_from("<II", content, at)
        if kind == 2:  # LC_SYMTAB
            table, count, strings, _ = struct.unpack_from("<IIII", content, at + 8)
        at += size
    names = set()
    for i in range(count):
        text, kind = struct.unpack_from("<IB", content, table + 16 * i)
        if kind & 0x1F == 0x0F:  # defined in a section, external, not private
            start = strings + text
            names.add(content[start : content.index(b"\0", start)].decode().removeprefix("_"))
    return names


def slices(content: bytes) -> dict[int, bytes]:
    """CPU type -> Mach-O file of a universal binary."""
    count = struct.unpack_from(">I", content, 4)[0]
    entries = [struct.unpack_from(">IIIII", content, 8 + 20 * i) for i in range(count)]
    assert all(offset % 2**align == 0 for _, _, offset, _, align in entries)
    return {cpu: content[offset : offset + size] for cpu, _, offset, size, _ in entries}


def run(*command: object, **options: object) -> str:
    result = subprocess.run(
        list(map(str, command)), capture_output=True, text=True, check=False, **options
    )  # type: ignore[call-overload]
    assert result.returncode == 0, result.stderr
    return str(result.stdout)


def elf_exports(path: Path) -> set[str]:
    return {line.split()[-1] for line in run("nm", "-D", "--defined-only", path).splitlines()}


def pe_exports(path: Path) -> set[str]:
    table = run("objdump", "-p", path).split("[Ordinal/Name Pointer] Table")[1].split("\n\n")[0]
    return {line.split()[-1] for line in table.splitlines() if "]" in line}


X86_CPU, ARM_CPU = 0x01000007, 0x0100000C
MACH = b"\xcf\xfa\xed\xfe"


@needs_zig
@pytest.mark.parametrize(("kind", "fmi"), [("battery", 3), ("replay", 2), ("replay", 3)])
def test_formats_and_exports(everywhere: FmuPath, fmu_folder: FmuPath, kind: str, fmi: int) -> None:
    folder = everywhere(kind, fmi)
    expected = elf_exports(library(fmu_folder(kind, fmi)))
    assert f"fmi{fmi}DoStep" in expected
    for platform, machine in (("linux64", 62), ("aarch64-linux", 183)):
        path = binary(folder, fmi, platform)
        head = path.read_bytes()[:20]
        assert (head[:5], struct.unpack_from("<H", head, 18)[0]) == (b"\x7fELF\x02", machine)
        assert elf_exports(path) == expected
        versions = run("objdump", "-T", path) if platform == "linux64" else ""
        found = {w.strip("()") for w in versions.split() if "GLIBC_" in w}
        assert all(int(v.split(".")[1]) <= 17 for v in found), found
    dll = binary(folder, fmi, "win64")
    content = dll.read_bytes()
    (start,) = struct.unpack_from("<I", content, 60)
    assert content[:2] == b"MZ"
    assert struct.unpack_from("<4sH", content, start) == (b"PE\0\0", 0x8664)
    assert struct.unpack_from("<H", content, start + 24)[0] == 0x20B  # PE32+
    assert pe_exports(dll) == expected
    needed = {
        x.split()[-1].lower() for x in run("objdump", "-p", dll).splitlines() if "DLL Name" in x
    }
    assert all(n == "kernel32.dll" or n.startswith("api-ms-win-crt-") for n in needed), needed
    apple = {
        X86_CPU: binary(folder, fmi, "darwin64").read_bytes(),
        ARM_CPU: binary(folder, fmi, "darwin-arm64").read_bytes(),
    }
    if fmi == 2:  # darwin64 serves both kinds of Mac
        both = slices(apple[X86_CPU])
        assert both[ARM_CPU] == apple[ARM_CPU]
        apple[X86_CPU] = both[X86_CPU]
    for cpu, mach in apple.items():
        assert (mach[:4], struct.unpack_from("<I", mach, 4)[0]) == (MACH, cpu)
        linker = {"__dso_handle", "_mh_dylib_header"}  # every library has them
        assert mach_exports(mach) - linker == expected


@needs_zig
def test_fmpy_lists_and_accepts_them(everywhere: FmuPath) -> None:
    folder = everywhere("replay", 2)
    found = set(fmpy.supported_platforms(str(folder)))
    assert found == {"c-code", "linux64", "win64", "darwin64"}
    assert {p.name for p in (folder / "binaries").iterdir()} == {
        "linux64",
        "aarch64-linux",
        "win64",
        "darwin64",
        "aarch64-darwin",
    }
    assert {p.name for p in (everywhere("replay", 3) / "binaries").iterdir()} == {
        "x86_64-linux",
        "aarch64-linux",
        "x86_64-windows",
        "x86_64-darwin",
        "aarch64-darwin",
    }


def test_universal_binary_holds_both() -> None:
    x86 = MACH + struct.pack("<II", X86_CPU, 3) + b"x" * 5
    arm = MACH + struct.pack("<II", ARM_CPU, 0) + b"a" * 40_000
    assert slices(universal_binary(x86, arm)) == {X86_CPU: x86, ARM_CPU: arm}


# -- bytes ----------------------------------------------------------------------------------


@needs_zig
@pytest.mark.slow
def test_two_builds_are_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled anew, from another working directory, platforms in another order and twice."""
    first = build(model("battery"), tmp_path / "a.fmu", 2, ["all"]).read_bytes()
    warm = Path(os.environ.get("UAVTWIN_CACHE") or _cache()) / "zig"
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "zig").symlink_to(warm)  # its libraries, minutes for Windows
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "empty"))
    monkeypatch.chdir(tmp_path)
    again = build(model("battery"), Path("b.fmu"), 2, [*reversed(PLATFORMS), "win64"])
    assert hashlib.sha256(again.read_bytes()).digest() == hashlib.sha256(first).digest()
    kept = [p for p in (tmp_path / "empty").glob("*.*") if p.suffix != ".o"]
    assert len(kept) == len(PLATFORMS)
    assert {p.name for p in tmp_path.iterdir()} == {"a.fmu", "b.fmu", "empty"}  # no zig-cache


def _cache() -> Path:
    from fmus.builder import cache_folder

    return cache_folder()


@needs_zig
@pytest.mark.slow
def test_zig_libraries_come_anew_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With zig's own cache empty too; Windows, where that takes minutes, was compared by hand."""
    chosen = ["aarch64-linux"]
    first = build(model("battery"), tmp_path / "a.fmu", 3, chosen).read_bytes()
    monkeypatch.setenv("UAVTWIN_CACHE", str(tmp_path / "empty"))
    assert build(model("battery"), tmp_path / "b.fmu", 3, chosen).read_bytes() == first
    assert (tmp_path / "empty" / "zig").is_dir()


# -- numbers --------------------------------------------------------------------------------


def driven(instance: Instance, inputs: list[str]) -> np.ndarray:
    """Outputs over STEPS steps, the inputs changed in each; those that start at 0, moments among
    them, by no more than a palm-sized aircraft stands."""
    middle = [instance.get(name) for name in inputs]
    rows = []
    for k in range(STEPS):
        for i, (name, value) in enumerate(zip(inputs, middle, strict=True)):  # as in host.c
            u = (k * 7919 + i * 1009) % 4096 / 40960
            instance.set({name: value * (0.95 + u) if value else (0.5 + u) / 1e5})
        instance.step(k * 1e-3)
        rows.append(instance.outputs())
    return np.array(rows)


def input_names(kind: str) -> list[str]:
    return [] if kind == "replay" else [v.name for v in component(kind).inputs]


@needs_zig
@needs(fmpy.platform_tuple == "x86_64-linux", "linux64 does not run here")
@pytest.mark.parametrize(("kind", "fmi"), KINDS)
def test_zig_gives_the_numbers_of_cc(
    everywhere: FmuPath, fmu_folder: FmuPath, kind: str, fmi: int
) -> None:
    results = []
    for folder in (fmu_folder(kind, fmi), everywhere(kind, fmi)):
        instance = Instance(folder).start()
        results.append(driven(instance, input_names(kind)))
        instance.close()
    assert results[0].tobytes() == results[1].tobytes()
    assert np.ptp(results[0], axis=0).max() > 1e-7


@cache
def host_program(folder: Path, fmi: int, platform: str) -> Path:
    p = PLATFORMS[platform]
    # Stripped like the FMUs: else zig compiles the C runtime of Windows once more, in minutes.
    out = folder / f"host{fmi}{'.exe' if platform == 'win64' else '-' + platform}"
    run(
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-target",
        p.target,
        "-std=c99",
        "-O2",
        "-ffp-contract=off",
        "-s",
        f"-DFMI={fmi}",
        f"-I{HEADERS}",
        HOST_SOURCE,
        "-o",
        out,
        *([] if platform == "win64" else ["-ldl"]),
        cwd=folder,
        env={
            **os.environ,
            "ZIG_GLOBAL_CACHE_DIR": str(_cache().absolute() / "zig"),
            "ZIG_LOCAL_CACHE_DIR": str(folder / "zig"),
        },
    )
    return out


@pytest.fixture(scope="session")
def hosts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("hosts")


def host_outputs(
    hosts: Path, folder: Path, kind: str, fmi: int, platform: str, files: Path | None = None
) -> np.ndarray:
    """Outputs of the C host, run for a platform; `files` instead of the FMU's resources."""
    runner: dict[str, list[object]] = {
        "linux64": [],
        "aarch64-linux": ["qemu-aarch64", "-L", ARM_LIBRARIES],
        "win64": ["wine"],
    }
    windows = platform == "win64"
    files = files or folder / "resources"
    resources, uri = files.as_posix(), files.as_uri()
    if windows:
        resources, uri = f"Z:{resources}", uri.replace("file:///", "file:///Z:/")
    outputs = [
        v.valueReference
        for v in fmpy.read_model_description(str(folder)).modelVariables
        if v.causality == "output" and v.type != "Boolean"
    ]
    text = run(
        *runner[platform],
        host_program(hosts, fmi, platform),
        f"{'Z:' if windows else ''}{binary(folder, fmi, platform)}",
        token(folder),
        uri if fmi == 2 else f"{resources}/",
        0,
        0,
        outputs[0],
        len(outputs),
        STEPS,
        len(input_names(kind)),
        env={**os.environ, "WINEPREFIX": str(hosts / "wine"), "WINEDEBUG": "-all", "DISPLAY": ""},
    )
    return np.array([float(x) for x in text.split()]).reshape(STEPS, -1)


@needs_zig
@pytest.mark.slow
@needs(fmpy.platform_tuple == "x86_64-linux", "linux64 does not run here")
@pytest.mark.parametrize(
    "platform",
    [
        pytest.param("aarch64-linux", marks=needs_qemu),
        pytest.param("win64", marks=needs_wine),
    ],
)
@pytest.mark.parametrize(("kind", "fmi"), KINDS)
def test_another_platform_gives_the_same_numbers(
    everywhere: FmuPath, hosts: Path, kind: str, fmi: int, platform: str
) -> None:
    folder = everywhere(kind, fmi)
    here = host_outputs(hosts, folder, kind, fmi, "linux64")
    there = host_outputs(hosts, folder, kind, fmi, platform)
    assert np.ptp(here, axis=0).max() > 1e-7
    differ = here != there
    summary = (
        f"{differ.any(axis=1).sum()} of {STEPS} steps differ in outputs "
        f"{np.flatnonzero(differ.any(axis=0))}, by at most {np.abs(here - there).max():.3g}"
    )
    print(summary)
    if kind == "airframe-crazyflie" and platform == "win64":
        # pow of Windows' C library is not glibc's to the last bit. It scales thrust with voltage
        # (thrust curve of this vehicle) and gives the battery current.
        np.testing.assert_allclose(there, here, rtol=1e-9, atol=1e-9, err_msg=summary)
    else:
        assert here.tobytes() == there.tobytes(), summary


@needs_zig
@needs_wine
@pytest.mark.slow
def test_windows_opens_resources_below_any_name(
    everywhere: FmuPath, hosts: Path, tmp_path: Path
) -> None:
    """FMI paths are UTF-8; Windows' fopen takes another encoding."""
    folder = everywhere("replay", 2)
    files = tmp_path / "Flüge 飛行"
    shutil.copytree(folder / "resources", files)
    moved = host_outputs(hosts, folder, "replay", 2, "win64", files)
    assert moved.tobytes() == host_outputs(hosts, folder, "replay", 2, "win64").tobytes()


# -- choice ---------------------------------------------------------------------------------


def test_names() -> None:
    assert [p.name for p in select_platforms(["win64", "linux64", "win64"])] == ["linux64", "win64"]
    assert [p.name for p in select_platforms(["all"])] == list(PLATFORMS)
    with pytest.raises(FmuError, match=r"no platform 'windows64'\. Did you mean 'win64'"):
        select_platforms(["windows64"])
    with pytest.raises(FmuError, match=r"no platform given\. Known: linux64, "):
        select_platforms([])


@needs_zig
def test_export_lists_the_platforms(tmp_path: Path) -> None:
    def export(*options: str) -> subprocess.CompletedProcess[str]:
        command = [
            sys.executable,
            "-c",
            "from uavtwin.cli.main import main; main()",
            "export",
            "battery",
        ]
        return subprocess.run(
            [*command, "--out", "o", *options],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )

    wrong = export("--vehicle", "crazyflie", "--platform", "linux64,win46")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "error: FMU: there is no platform 'win46'. Did you mean 'win64'?" in wrong.stderr
    assert not (tmp_path / "o").exists()
    listed = export("--fmi", "2,3", "--vehicle", "crazyflie", "--platform", "aarch64-linux,linux64")
    assert listed.returncode == 0, listed.stderr
    assert "fmi2/battery.fmu  FMI 2  linux64,aarch64-linux  " in listed.stdout
    assert "fmi3/battery.fmu  FMI 3  linux64,aarch64-linux  " in listed.stdout
