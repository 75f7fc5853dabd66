"""Shared libraries of all systems, as other projects ship them: told apart, and cut ones found."""

from pathlib import Path

import fmpy
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fmus.inspect import library_problem, library_suffix
from fmus.platforms import PLATFORMS

FMPY = Path(fmpy.__file__).parent
SHIPPED = {
    "linux64": FMPY / "logging/linux64/logging.so",
    "win32": FMPY / "logging/win32/logging.dll",
    "win64": FMPY / "logging/win64/logging.dll",
    "darwin64": FMPY / "logging/darwin64/logging.dylib",
    "aarch64-darwin": FMPY / "sundials/aarch64-darwin/sundials_core.dylib",
}


@pytest.mark.parametrize("platform", SHIPPED)
def test_a_library_is_for_its_own_platform_alone(platform: str) -> None:
    content = SHIPPED[platform].read_bytes()
    assert library_problem(content, platform) is None
    for other in SHIPPED.keys() - {platform}:
        if {platform, other} == {"darwin64", "aarch64-darwin"}:
            continue  # FMI 2 has one folder for all Macs
        assert f"not for {other}" in str(library_problem(content, other))


@pytest.mark.parametrize("platform", SHIPPED)
def test_each_cut_is_found(platform: str) -> None:
    content = SHIPPED[platform].read_bytes()
    for length in (*range(0, 2000, 7), len(content) // 2, len(content) - 1):
        said = library_problem(content[:length], platform)
        assert said is not None and ("is cut" in said or length < 4), (length, said)


def test_an_arm_library_in_the_place_of_linux64() -> None:
    content = bytearray(SHIPPED["linux64"].read_bytes())
    content[18:20] = (183).to_bytes(2, "little")  # e_machine of the ELF header
    arm = bytes(content)
    assert library_problem(arm, "aarch64-linux") is None
    assert library_problem(arm, "linux64") == "is for aarch64 on linux, not for linux64"


def test_a_universal_binary_is_for_both() -> None:
    """That of FMPy is one."""
    both = SHIPPED["darwin64"].read_bytes()
    assert both.startswith(b"\xca\xfe\xba\xbe")
    for platform in ("x86_64-darwin", "aarch64-darwin"):
        assert library_problem(both, platform) is None


@pytest.mark.parametrize("content", [b"", b"int main(void);\n", b"MZ not a library", b"\x7fELF"])
def test_what_is_no_library(content: bytes) -> None:
    assert library_problem(content, "linux64") is not None


@example("linux64", [(39, 128)])
@given(
    st.sampled_from(sorted(SHIPPED)), st.lists(st.tuples(st.integers(0, 500), st.integers(0, 255)))
)
def test_any_header_gets_an_answer(platform: str, changes: list[tuple[int, int]]) -> None:
    content = bytearray(SHIPPED[platform].read_bytes())
    for at, value in changes:
        content[at] = value
    said = library_problem(bytes(content), platform)
    assert said is None or said.startswith("is ")


def test_every_platform_that_we_build_for_is_known() -> None:
    for platform in PLATFORMS.values():
        assert {library_suffix(f) for f in platform.folders.values()} == {platform.suffix}
    assert library_suffix("c-code") is None
