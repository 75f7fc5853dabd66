"""FMUs as another tool might have made them: ours with another description or other C code."""

import re
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path

UNKNOWN_DEPENDENCIES = {r' dependencies="[^"]*"': ""}
NO_DERIVATIVES = {r'(providesDirectionalDerivatives?)="true"': r'\1="false"'}
NO_STATES = {r'(canGetAndSetFMUstate)="true"': r'\1="false"'}


def altered(
    path: Path,
    name: str,
    description: Mapping[str, str] | None = None,
    source: Mapping[str, str] | None = None,
) -> Path:
    """A changed copy beside an FMU.

    Args:
        path: The FMU.
        name: File name of the copy.
        description: Patterns in `modelDescription.xml` -> replacements.
        source: Texts in `fmi2.c` or `fmi3.c` -> replacements; the library is compiled again.
    """
    with zipfile.ZipFile(path) as archive:
        members = {n: archive.read(n) for n in archive.namelist()}
    text = members["modelDescription.xml"].decode()
    for pattern, replacement in (description or {}).items():
        assert re.search(pattern, text), pattern
        text = re.sub(pattern, replacement, text)
    members["modelDescription.xml"] = text.encode()
    if source:
        _recompile(members, source)
    new = path.with_name(name)
    with zipfile.ZipFile(new, "w") as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return new


def _recompile(members: dict[str, bytes], changes: Mapping[str, str]) -> None:
    shim = next(n for n in members if re.fullmatch(r"sources/fmi[23]\.c", n))
    code = members[shim].decode()
    for old, new in changes.items():
        assert old in code, old
        code = code.replace(old, new)
    members[shim] = code.encode()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for member in members:
            if member.startswith("sources/"):
                (folder / member.removeprefix("sources/")).write_bytes(members[member])
        files = sorted(p.name for p in folder.glob("*.c"))
        command = ["cc", "-std=c99", "-O1", "-fPIC", "-shared", "-w", "-o", "fmu.so", *files, "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        library = next(n for n in members if n.startswith("binaries/"))
        members[library] = (folder / "fmu.so").read_bytes()
