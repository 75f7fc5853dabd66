"""Zip archives, FMUs and SSPs: their XML, their lists of members and what lies in them changed."""

import io
import random
import struct
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from lxml import etree

from cosim.ssp import write_ssp
from cosim.system import Connection, System
from fmus import component_model
from fmus.description import model_description
from twin.component import Component

from .checked import read_checked
from .engine import Seen, Step
from .feedback import amplifier, motor
from .flights import Long, apply_bytes, draw_bytes, spelled

_VALUES: tuple[Long, ...] = (
    *(
        "",
        "0",
        "-1",
        "1e308",
        "1e999",
        "NaN",
        "INF",
        "4294967296",
        ("9", 400),
        "true",
        ("x", 100_000),
    ),
    *("../../x", "/etc/passwd", "file:///etc/passwd", "a b", '"', "%00", "\u202e", "3.0", "1.0"),
)
_NAMES: tuple[Long, ...] = (
    "../x",
    "/x",
    "a\\x",
    "C:x",
    ("x", 600),
    "",
    "a/../../x",
    "MODELDESCRIPTION.XML",
    "a\nb",
    "é",
)
_FIELDS = {
    **{"flags": (8, "<H"), "method": (10, "<H"), "crc": (16, "<I"), "packed": (20, "<I")},
    **{"size": (24, "<I"), "name": (28, "<H"), "extra": (30, "<H"), "attributes": (38, "<I")},
    "offset": (42, "<I"),
}
"""Of an entry of the list of members, PKWARE APPNOTE 4.3.12: offset and form."""
_LAUGHS = b"<!DOCTYPE x [<!ENTITY a0 'ha'>%s]>" % b"".join(
    b"<!ENTITY a%d '%s'>" % (k, b"&a%d;" % (k - 1) * 10) for k in range(1, 10)
)
_BYTES = ("flip", "cut", "repeat", "remove")
_OF_XML = ("attribute", "unset", "drop", "copy", "rename", "deep", "entity", "text")
_OF_ZIP = ("field", "twice", "called", "bomb", "many", "without")


@dataclass(frozen=True)
class Archives:
    """The kind.

    Attributes:
        file: Name of an input.
        make: Sound ones.
        xml: How the names of its own XML members end.
    """

    file: str
    make: Callable[[], dict[str, bytes]]
    xml: tuple[str, ...]
    visible: frozenset[str] = frozenset({"twice", "library"})

    def bases(self) -> dict[str, bytes]:
        """Of code alone; their libraries are headers."""
        return self.make()

    def draw(self, rng: random.Random, blob: bytes) -> Step:
        """Most of them know the format."""
        members = _members(blob)
        if not members or rng.random() < 0.15:
            return draw_bytes(rng, blob)
        chance = rng.random()
        nested = [n for n in members if n.endswith(".fmu")]
        if nested and chance < 0.3:
            name = rng.choice(nested)
            return "inside", {"member": name, "step": list(FMU.draw(rng, members[name]))}
        described = [n for n in members if n.endswith(self.xml)]
        if described and chance < 0.75:
            name = rng.choice(described)
            return _drawn_xml(rng, name, members[name])
        libraries = [n for n in members if n.startswith("binaries/") and members[n]]
        if libraries and chance < 0.8:
            return "library", {
                "member": rng.choice(libraries),
                "as": rng.choice(("cut", "arm", "text")),
            }
        return _drawn_zip(rng, sorted(members), members)

    def apply(self, blob: bytes, step: Step) -> bytes:
        """As drawn; what an earlier change took away is left."""
        name, given = step
        if name in _BYTES:
            return apply_bytes(blob, step)
        members = _members(blob)
        member = str(given.get("member", ""))
        if not members or ("member" in given and member not in members):
            return blob
        if name == "field":
            return _patched(blob, given)
        if name in ("twice", "called", "many", "bomb"):
            return _packed(_listed(members, name, given))
        if name == "without":
            del members[member]
        elif name == "inside":
            members[member] = FMU.apply(members[member], (given["step"][0], given["step"][1]))
        elif name == "damage":
            members[member] = apply_bytes(members[member], (given["step"][0], given["step"][1]))
        elif name == "library":
            content = members[member]
            arm = content[:18] + struct.pack("<H", 183) + content[20:]
            as_ = {"cut": content[: len(content) // 2], "arm": arm, "text": b"not a library\n"}
            members[member] = as_[given["as"]]
        else:
            members[member] = _changed_xml(members[member], name, given)
        return _packed(members.items())

    def read(self, path: Path) -> Seen:
        """As `uavtwin check`."""
        return read_checked(path)


def _members(blob: bytes) -> dict[str, bytes]:
    """Content by name; none of what cannot be read."""
    try:
        with zipfile.ZipFile(io.BytesIO(blob)) as archive:
            if sum(m.file_size for m in archive.infolist()) > 2**24:
                return {}
            return {m.filename: archive.read(m) for m in archive.infolist()}
    except Exception:  # of zipfile and zlib, on what earlier changes left
        return {}


def _packed(members: Any, level: int = 1) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=level) as archive:
        for name, content in members:
            archive.NameToInfo.pop(name, None)  # else a name that is there twice is a warning
            info = zipfile.ZipInfo("x")
            info.filename, info.compress_type = name, zipfile.ZIP_DEFLATED
            archive.writestr(info, content)
    return file.getvalue()


# -- the list of members --------------------------------------------------------------------


def _drawn_zip(rng: random.Random, names: list[str], members: dict[str, bytes]) -> Step:
    name = rng.choices(_OF_ZIP, (80, 40, 40, 1, 1, 40))[0]
    member = rng.choice(names)
    match name:
        case "field":
            return name, {
                "at": rng.randrange(99),
                "field": rng.choice(sorted(_FIELDS)),
                "to": rng.choice((0, 1, 8, 12, 99, 0xA1ED0000, 2**32 - 1, rng.getrandbits(32))),
            }
        case "called":
            return name, {"name": rng.choice(_NAMES)}
        case "bomb":
            return name, {"name": rng.choice(("a.bin", member)), "mib": rng.choice((100, 600))}
        case "many":
            return name, {"count": rng.choice((19_000, 25_000))}
        case "without" if rng.random() < 0.5 and members[member]:
            return "damage", {"member": member, "step": list(draw_bytes(rng, members[member]))}
        case _:
            return name, {"member": member}


def _listed(members: dict[str, bytes], name: str, given: dict[str, Any]) -> Iterator[Any]:
    """Members with one more, or many."""
    match name:
        case "twice":
            yield from members.items()
            yield given["member"], members[given["member"]]
        case "called":
            yield from members.items()
            yield spelled(given["name"]), b"x"
        case "bomb":
            yield from ((n, c) for n, c in members.items() if n != given["name"])
            yield given["name"], bytes(given["mib"] * 2**20)
        case "many":
            yield from members.items()
            yield from ((f"m{k}", b"") for k in range(given["count"]))


def _patched(blob: bytes, given: dict[str, Any]) -> bytes:
    """The archive with a number in one entry of its list changed."""
    entries = []
    at = blob.find(b"PK\1\2")
    while at >= 0:
        entries.append(at)
        at = blob.find(b"PK\1\2", at + 4)
    offset, form = _FIELDS[given["field"]]
    place = entries[given["at"] % len(entries)] + offset
    out = bytearray(blob)
    size = struct.calcsize(form)
    out[place : place + size] = (given["to"] % 256**size).to_bytes(size, "little")
    return bytes(out)


# -- XML ------------------------------------------------------------------------------------


def _drawn_xml(rng: random.Random, member: str, content: bytes) -> Step:
    if rng.random() < 0.1:
        return "damage", {"member": member, "step": list(draw_bytes(rng, content or b"\0"))}
    name = rng.choices(_OF_XML, (12, 3, 4, 4, 3, 1, 1, 1))[0]
    given: dict[str, Any] = {"member": member, "at": rng.randrange(10_000)}
    match name:
        case "attribute":
            given |= {"which": rng.randrange(99), "to": rng.choice(_VALUES)}
        case "unset":
            given |= {"which": rng.randrange(99)}
        case "copy":
            given |= {"times": rng.choice((1, 1, 1, 30, 3000))}
        case "rename":
            given |= {"to": rng.choice(("Real", "Float64", "Item", "System", "x", "Integer"))}
        case "deep":
            given |= {"depth": rng.choice((20, 300, 100_000))}
        case "text":
            given |= {"to": rng.choice(("x", "&#0;", "<!--", "]]>", "\ud800"))}
    return name, given


def _tree(content: bytes) -> Any:
    """Of any size and depth."""
    return etree.fromstring(content, etree.XMLParser(resolve_entities=False, huge_tree=True))


def _changed_xml(content: bytes, name: str, given: dict[str, Any]) -> bytes:
    """One change to the tree; what is no XML any more is left."""
    try:
        root = _tree(content)
    except etree.XMLSyntaxError:
        return content
    elements = list(root.iter("*"))
    element = elements[given["at"] % len(elements)]
    match name:
        case "attribute" | "unset" if element.attrib:
            key = sorted(element.attrib)[given["which"] % len(element.attrib)]
            if name == "attribute":
                element.set(key, spelled(given["to"]))
            else:
                del element.attrib[key]
        case "drop" if element.getparent() is not None:
            element.getparent().remove(element)
        case "copy" if (parent := element.getparent()) is not None:
            text = etree.tostring(element)
            if len(text) * given["times"] < 2**22:
                parent.extend([_tree(text) for _ in range(given["times"])])
        case "rename":
            space = etree.QName(element).namespace
            element.tag = f"{{{space}}}{given['to']}" if space else given["to"]
        case "deep" | "text":
            element.text = "@mark@"
            depth = given.get("depth", 0)
            inner = "<x>" * depth + "</x>" * depth if depth else given["to"]
            return bytes(etree.tostring(root)).replace(b"@mark@", inner.encode(errors="replace"))
        case "entity":
            element.text = "@mark@"
            return _LAUGHS + bytes(etree.tostring(root)).replace(b"@mark@", b"&a9;")
    return bytes(etree.tostring(root))


# -- sound ones -----------------------------------------------------------------------------


def _header(size: int = 4096) -> bytes:
    """A library of x86-64 Linux that is nothing but its ELF header."""
    start = b"\x7fELF\2\1\1" + bytes(9)
    start += struct.pack("<HHIQQQIHHHHHH", 3, 62, 1, 0, 64, 0, 0, 64, 56, 1, 0, 0, 0)
    return start + struct.pack("<IIQQQQQQ", 1, 5, 0, 0, 0, size, size, 4096) + bytes(size - 120)


def _fmu(component: Component, fmi: int) -> bytes:
    folder = {2: "linux64", 3: "x86_64-linux"}[fmi]
    description = model_description(component_model(component), fmi, "{token}", ["all.c"])
    members = {
        "modelDescription.xml": description,
        f"binaries/{folder}/{component.name}.so": _header(),
        "sources/all.c": b"int one(void) { return 1; }\n",
    }
    return _packed(members.items())


@cache
def _fmus() -> dict[str, bytes]:
    return {"motor": _fmu(motor(), 2), "amplifier": _fmu(amplifier(), 3)}


@cache
def _ssps() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, content in _fmus().items():
            (folder / f"{name}.fmu").write_bytes(content)
        motor, amplifier = folder / "motor.fmu", folder / "amplifier.fmu"
        system = System(
            {"motor": motor, "amplifier": amplifier, "second": motor},
            (
                Connection("motor.speed", "amplifier.speed"),
                Connection("amplifier.u", "motor.u"),
                Connection("amplifier.u", "second.u"),
            ),
            {"motor.initial.speed": 0.3, "second.on": 0.0, "amplifier.gain": 1.5},
            {"second": 4},
            stop_time_s=3.5,
            step_s=0.01,
        )
        return {"drive": write_ssp(system, folder / "drive.ssp").read_bytes()}


FMU = Archives("input.fmu", _fmus, (".xml",))
SSP = Archives("input.ssp", _ssps, (".ssd", ".ssv"))
