"""The C inside: no warnings, nothing but libc and libm, and a host without Python."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from instance import Instance, library, token, unzip
from kinds import ALL, component, replay_example
from places import HOST_SOURCE

FmuPath = Callable[[str, int], Path]
HEADERS = Path(fmpy.__file__).parent / "c-code"
SANITIZE = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
CHANGED, VALUE = "initial.omega_x", 0.3


def cc(*arguments: object, cwd: Path | None = None) -> str:
    """Compile, and return what the compiler had to say."""
    result = subprocess.run(
        ["cc", "-std=c99", *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return result.stderr


def compile_host(folder: Path, fmi: int, *flags: str) -> Path:
    path = folder / f"host{fmi}{len(flags)}"
    if not path.exists():
        strict = ("-Wall", "-Wextra", "-Werror", "-O1")
        cc(*strict, *flags, f"-DFMI={fmi}", f"-I{HEADERS}", HOST_SOURCE, "-o", path, "-ldl")
    return path


@pytest.fixture(scope="module")
def bin_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("bin")


def host(
    program: Path, folder: Path, fmi: int, kind: str, binary: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run an extracted FMU in the C host, all its outputs printed."""
    resources = folder / "resources"
    with_start = kind.startswith("airframe")
    names = [v.name for v in component(kind).variables] if with_start else []
    description = fmpy.read_model_description(str(folder))
    outputs = [
        v.valueReference
        for v in description.modelVariables
        if v.causality == "output" and v.type != "Boolean"
    ]
    return subprocess.run(
        [
            program,
            binary or library(folder),
            token(folder),
            resources.as_uri() if fmi == 2 else f"{resources}/",
            str(1 + names.index(CHANGED)) if with_start else "0",
            str(VALUE),
            str(outputs[0]),
            str(len(outputs)),
        ],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "ASAN_OPTIONS": "detect_leaks=1", "LANG": "C"},
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["airframe-crazyflie", "replay"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_c_host_prints_the_bits_of_fmpy(
    fmu_folder: FmuPath, bin_folder: Path, new: Callable[[str, int], Instance], kind: str, fmi: int
) -> None:
    result = host(compile_host(bin_folder, fmi), fmu_folder(kind, fmi), fmi, kind)
    assert result.returncode == 0, result.stderr
    instance = new(kind, fmi).start({CHANGED: VALUE} if kind != "replay" else None)
    reals = [instance.types[n] != "Boolean" for n in instance.output_names]
    expected = instance.run(1000)[:, reals]
    got = np.array([float(x) for x in result.stdout.split()]).reshape(1000, -1)
    assert got.tobytes() == np.ascontiguousarray(expected).tobytes()
    assert np.ptp(got, axis=0).max() > 0.1  # something moved


@pytest.mark.parametrize("fmi", [2, 3])
def test_c_host_prints_the_messages(fmu_folder: FmuPath, bin_folder: Path, fmi: int) -> None:
    result = host(compile_host(bin_folder, fmi), fmu_folder("battery", fmi), fmi, "battery")
    said = result.stderr.splitlines()
    name = "GUID" if fmi == 2 else "instantiation token"
    assert said[0] == f"{name} does not match: binary and modelDescription.xml differ"
    assert said[1] == "a step cannot be made before initialization"
    assert said[2] == "doStep at -7 s, but the FMU is at 0.01 s"
    assert said[3] == "no variable has value reference 99999"
    assert any(line.startswith("saved state has ") for line in said)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "fmi"), ALL)
def test_library_needs_only_libc_and_libm(fmu_folder: FmuPath, kind: str, fmi: int) -> None:
    path = library(fmu_folder(kind, fmi))

    def lines(*command: str) -> list[str]:
        return subprocess.run(
            [*command, path], capture_output=True, text=True, check=True
        ).stdout.splitlines()

    needed = {line.split()[0].rsplit("/", 1)[-1].split(".so")[0] for line in lines("ldd")}
    assert needed <= {"linux-vdso", "libc", "libm", "ld-linux-x86-64", "ld-linux-aarch64"}, needed
    undefined = [line.split() for line in lines("nm", "-D", "--undefined-only")]
    strong = {symbol for mark, symbol in undefined if mark == "U"}
    assert all("@GLIBC_" in symbol for symbol in strong), strong
    exported = {line.split()[-1] for line in lines("nm", "-D", "--defined-only")}
    assert exported  # and nothing that could be taken for another FMU's function
    assert all(symbol.startswith(f"fmi{fmi}") for symbol in exported), exported


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "fmi"),
    [(k, f) for k, f in ALL if k in ("airframe-crazyflie", "imu", "replay", "fused")],
)
def test_sources_in_the_fmu_compile_without_warning(
    fmu_folder: FmuPath, tmp_path: Path, kind: str, fmi: int
) -> None:
    """Compiled from the archive alone; CasADi's code once, it is the same in both versions."""
    sources, other = (fmu_folder(kind, version) / "sources" for version in (fmi, 2))
    strict = ["-Wall", "-Wextra", "-Werror", "-O2", "-fPIC", "-c"]
    for path in sorted(sources.glob("*.c")):
        # CasADi's functions have arguments that not every function needs.
        generated = path.name.startswith("kernels_")
        lenient = ["-Wno-unused-parameter"] if generated else []
        optimise = ["-O1"] if generated else []  # time
        if generated and fmi == 3:
            assert path.read_text() == (other / path.name).read_text()
            continue
        assert cc(*strict, *optimise, *lenient, path, "-o", tmp_path / "o.o") == ""


def sanitized(folder: Path, out: Path) -> Path:
    """The library of an extracted FMU, compiled from its own sources with the sanitizers."""
    path = out / f"{folder.name}.so"
    flags = ("-O0", "-ffp-contract=off", "-fPIC", "-shared", *SANITIZE)
    if not path.exists():
        sources = sorted(p.name for p in (folder / "sources").glob("*.c"))
        cc(*flags, *sources, "-o", path, "-lm", cwd=folder / "sources")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["airframe-crazyflie", "replay", "fused"])
@pytest.mark.parametrize("fmi", [2, 3])
def test_no_memory_error_and_no_undefined_behaviour(
    fmu_folder: FmuPath, bin_folder: Path, kind: str, fmi: int
) -> None:
    """Sanitized and unoptimised, leaks included: the same bits as the FMU's own library."""
    folder = fmu_folder(kind, fmi)
    checked = host(
        compile_host(bin_folder, fmi, *SANITIZE),
        folder,
        fmi,
        kind,
        binary=sanitized(folder, bin_folder),
    )
    assert checked.returncode == 0, checked.stderr
    assert "Sanitizer" not in checked.stderr
    assert checked.stdout == host(compile_host(bin_folder, fmi), folder, fmi, kind).stdout


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_damaged_record_under_sanitizers(
    fmu_file: FmuPath, fmu_folder: FmuPath, bin_folder: Path, tmp_path: Path, fmi: int
) -> None:
    folder = unzip(fmu_file("replay", fmi), tmp_path / "fmu")
    binary = sanitized(fmu_folder("replay", fmi), bin_folder)
    program = compile_host(bin_folder, fmi, *SANITIZE)
    good = replay_example().resources["record.bin"]
    huge = b"\xff" * 8
    for content in (
        b"",
        good[:15],
        good[:16],
        good[:24],
        good[:40],
        good[: len(good) // 2],
        good[:-8],
        good[:-1],
        good[:16] + huge + good[24:],
        good[:8] + huge + good[16:],
    ):
        (folder / "resources/record.bin").write_bytes(content)
        result = host(program, folder, fmi, "replay", binary)
        assert result.returncode == 3, (len(content), result.stderr)
        assert "damaged" in result.stderr
        assert "Sanitizer" not in result.stderr
    rng = np.random.default_rng(0)  # right sizes, nonsense inside: any answer, but no crash
    for _ in range(3):
        nonsense = bytearray(good)
        nonsense[40:3200] = rng.bytes(3160)
        (folder / "resources/record.bin").write_bytes(nonsense)
        result = host(program, folder, fmi, "replay", binary)
        assert "Sanitizer" not in result.stderr, result.stderr
