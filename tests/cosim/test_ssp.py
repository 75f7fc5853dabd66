"""SSP files: valid, the same each time, read back, and what is refused in those of others."""

import gc
import re
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from fuzzing.feedback import amplifier, motor
from lxml import etree

from cosim.master import Master
from cosim.ssp import read_ssp, write_ssp
from cosim.system import Connection, System
from fmus import build, component_model
from twin.errors import FmuError

SSD = "SystemStructure.ssd"


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> System:
    """A motor, FMI 2, in a loop with an amplifier, FMI 3, that also drives a second motor."""
    folder = tmp_path_factory.mktemp("parts")
    motor_fmu = build(component_model(motor()), folder / "the motor.fmu")
    (folder / "other").mkdir()
    amplifier_fmu = build(component_model(amplifier()), folder / "other" / "the motor.fmu", 3)
    return System(
        {"motor": motor_fmu, "amplifier": amplifier_fmu, "second": motor_fmu},
        (
            Connection("motor.speed", "amplifier.speed"),
            Connection("amplifier.u", "motor.u"),
            Connection("amplifier.u", "second.u"),
        ),
        {
            "motor.initial.speed": 0.1 + 0.2,  # no short decimal
            "second.on": 0.0,
            "second.initial.speed": -3.0,
            "amplifier.gain": 1e-7 / 3,
        },
        {"second": 4},
        start_time_s=1.5,
        stop_time_s=3.5,
        step_s=0.01,
    )


@pytest.fixture
def ssp(system: System, tmp_path: Path) -> Path:
    return write_ssp(system, tmp_path / "drive.ssp")


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {n: archive.read(n) for n in archive.namelist()}


def rewritten(path: Path, changes: Mapping[str, str], member: str = SSD) -> Path:
    """The archive with one member's text changed, patterns -> replacements."""
    content = members(path)
    text = content[member].decode()
    for pattern, replacement in changes.items():
        assert re.search(pattern, text), pattern
        text = re.sub(pattern, replacement, text, count=1)
    content[member] = text.encode()
    new = path.with_name("theirs.ssp")
    with zipfile.ZipFile(new, "w") as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return new


# -- writing --------------------------------------------------------------------------------


def test_files_are_valid(ssp: Path) -> None:
    """Against the schemas of the standard."""
    folder = resources.files("fmpy") / "ssp" / "schema"
    schemas = {"ssd": "SystemStructureDescription", "ssv": "SystemStructureParameterValues"}
    found = 0
    for name, content in members(ssp).items():
        if name.endswith((".ssd", ".ssv")):
            schema = etree.XMLSchema(file=str(folder / f"{schemas[name[-3:]]}.xsd"))
            schema.assertValid(etree.fromstring(content))
            found += 1
    assert found == 4


def test_fmpy_reads_the_structure(ssp: Path) -> None:
    from fmpy.ssp.ssd import read_ssd

    top = read_ssd(str(ssp)).system
    assert [c.name for c in top.elements] == ["motor", "amplifier", "second"]
    assert len(top.connections) == 3


def test_the_same_bytes_each_time(system: System, ssp: Path, tmp_path: Path) -> None:
    (tmp_path / "again").mkdir()
    again = write_ssp(system, tmp_path / "again" / "drive.ssp")
    assert again.read_bytes() == ssp.read_bytes()
    names = list(members(ssp))
    assert names == sorted(names)
    assert "resources/the_motor.fmu" in names
    assert "resources/amplifier.the_motor.fmu" in names
    assert sum(n.endswith(".fmu") for n in names) == 2  # the motor is there once


def test_units_keep_their_meaning(ssp: Path) -> None:
    text = members(ssp)[SSD].decode()
    volt = '<ssc:BaseUnit kg="1" m="2" s="-3" A="-1" factor="1.0" offset="0.0"/>'
    assert re.search(rf'<ssc:Unit name="V">\s*{volt}', text)
    assert '<ssc:Real unit="rad/s"/>' in text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"step_s": None}, r"period of 'second' = 4: SSP needs a base step; give step_s"),
        ({"starts": {"second.on": 0.5}}, r"the motor\.fmu: on = 0\.5 is no Boolean value"),
        ({"starts": {"second.onn": 0.5}}, r"no variable 'onn'\. Did you mean 'on'\?"),
        ({"connections": (Connection("motor.speed", "second.u"),)}, r"units differ"),
    ],
)
def test_what_cannot_be_written(
    system: System, tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(FmuError, match=message):
        write_ssp(replace(system, **changes), tmp_path / "x.ssp")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_names_that_others_cannot_read(system: System, tmp_path: Path) -> None:
    odd = System({"left motor": system.fmus["motor"]})
    with pytest.raises(FmuError, match=r"slave 'left motor': other tools read only letters"):
        write_ssp(odd, tmp_path / "x.ssp")


# -- reading --------------------------------------------------------------------------------


def test_read_back(system: System, ssp: Path) -> None:
    back = read_ssp(ssp)
    assert list(back.fmus) == list(system.fmus)
    assert replace(back, fmus=system.fmus) == system
    runs = []
    for s in (system, back):
        with Master(s) as master:
            master.initialize()
            assert s.stop_time_s is not None
            assert s.step_s is not None
            runs.append(master.run(s.stop_time_s, s.step_s, "settled"))
    assert runs[0].time_s[0] == 1.5
    assert np.ptp(runs[0]["motor.speed"]) > 0.01
    assert runs[0].values.tobytes() == runs[1].values.tobytes()
    assert write_ssp(back, ssp.with_name("again.ssp")).is_file()


@pytest.mark.slow
def test_files_live_as_long_as_the_system(
    ssp: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temp = tmp_path / "temp"
    temp.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temp))
    with Master(replace(read_ssp(ssp), starts={})) as master:
        master.initialize()
    system = read_ssp(ssp)
    other = replace(system, starts={})
    del system, master
    gc.collect()
    assert all(p.is_file() for p in other.fmus.values())
    assert len(list(temp.iterdir())) == 1
    del other
    gc.collect()
    assert not list(temp.iterdir())
    with pytest.raises(FmuError):
        read_ssp(rewritten(ssp, {"<ssd:System ": "<ssd:Sistem "}))
    gc.collect()
    assert not list(temp.iterdir())


def test_other_spellings(ssp: Path, system: System) -> None:
    """Inline and system-level values, swapped ends, an idle transformation, comments, geometry."""
    values = (
        '<ssv:ParameterSet version="1.0" name="x"><ssv:Parameters><ssv:Parameter name="gain">'
        '<ssv:Real value="0.25"/></ssv:Parameter></ssv:Parameters></ssv:ParameterSet>'
    )
    inline = f"<ssd:ParameterValues>{values}</ssd:ParameterValues>"
    other = rewritten(
        ssp,
        {
            r'<ssd:System name="drive">': '<ssd:System name="drive"><!-- a comment -->'
            '<ssd:ParameterBindings><ssd:ParameterBinding prefix="second.">'
            + inline.replace('"gain"', '"initial.speed"')
            + "</ssd:ParameterBinding></ssd:ParameterBindings>",
            r"<ssd:Elements>": "<ssd:Elements><!-- more -->",
            r'<ssd:ParameterBinding type="[^"]*" source="resources/amplifier.ssv"/>': (
                f"<ssd:ParameterBinding>{inline}</ssd:ParameterBinding>"
            ),
            r'startElement="motor" startConnector="speed" endElement="amplifier" '
            r'endConnector="speed"/>': 'startElement="amplifier" startConnector="speed" '
            'endElement="motor" endConnector="speed">'
            '<ssc:LinearTransformation factor="1.0"/></ssd:Connection>',
            r'source="resources/the_motor.fmu"': 'source="resources/the%5Fmotor.fmu"',
        },
    )
    back = read_ssp(other)
    assert back.connections == system.connections
    assert back.starts == {**system.starts, "amplifier.gain": 0.25, "second.initial.speed": 0.25}
    assert replace(back, fmus={}, starts={}) == replace(system, fmus={}, starts={})


def test_without_our_annotations(ssp: Path) -> None:
    plain = rewritten(ssp, {r"(?s)<ssd:DefaultExperiment.*</ssd:DefaultExperiment>": ""})
    back = read_ssp(plain)
    assert (back.start_time_s, back.stop_time_s, back.step_s, back.periods) == (0, None, None, {})


REFUSED: dict[str, tuple[dict[str, str], str]] = {
    "version": ({r'version="1.0"': 'version="2.0"'}, r"SystemStructureDescription 1\.0 is read"),
    "no system": (
        {r"(?s)<ssd:System name.*</ssd:System>": ""},
        r"there is no System",
    ),
    "connectors of the system": (
        {
            r"<ssd:Elements>": '<ssd:Connectors><ssd:Connector name="u" kind="input"/>'
            "</ssd:Connectors><ssd:Elements>"
        },
        r"the system has connectors of its own\. Connect components only",
    ),
    "nested": (
        {r"<ssd:Elements>": '<ssd:Elements><ssd:System name="inner"/>'},
        r"'inner' is a System that is no FMU\. Flatten the system",
    ),
    "dictionary": (
        {r"<ssd:Elements>": '<ssd:Elements><ssd:SignalDictionaryReference name="bus"/>'},
        r"'bus' is a SignalDictionaryReference that is no FMU",
    ),
    "package in a package": (
        {r'type="application/x-fmu-sharedlibrary"': 'type="application/x-ssp-package"'},
        r"'motor' is a Component that is no FMU",
    ),
    "dot in a name": (
        {r'<ssd:Component name="second"': '<ssd:Component name="a.b"'},
        r"component name 'a\.b' is empty, holds a dot or comes twice",
    ),
    "model exchange": (
        {r'implementation="CoSimulation"': 'implementation="ModelExchange"'},
        r"'motor' asks for model exchange",
    ),
    "misspelt connector": (
        {r'<ssd:Connector name="speed"': '<ssd:Connector name="sped"'},
        r"theirs\.ssp: there is no connector of 'motor' 'sped'\. Did you mean 'speed'\?",
    ),
    "misspelt end": (
        {r'startConnector="speed"': 'startConnector="spede"'},
        r"theirs\.ssp: there is no connector of 'motor' 'spede'\. Did you mean 'speed'\?",
    ),
    "misspelt component": (
        {r'endElement="amplifier"': 'endElement="amplifyer"'},
        r"there is no component 'amplifyer'\. Did you mean 'amplifier'\?",
    ),
    "connection with the outside": (
        {r'startElement="motor" ': ""},
        r"connection with the system's own 'speed'\. Flatten",
    ),
    "two inputs": (
        {r'startElement="motor" startConnector="speed"': 'startElement="motor" startConnector="u"'},
        r"motor\.u \(input\) -> amplifier\.speed \(input\): only outputs and inputs",
    ),
    "two sources": (
        {r'endElement="second"': 'endElement="motor"'},
        r"theirs\.ssp: motor\.u has two sources",
    ),
    "units": (
        {
            r'startElement="motor" startConnector="speed" endElement="amplifier" '
            r'endConnector="speed"': 'startElement="motor" startConnector="speed" '
            'endElement="second" endConnector="u" suppressUnitConversion="true"'
        },
        r"motor\.speed \[rad/s\] -> second\.u \[V\]: units differ",
    ),
    "kind": (
        {r'name="speed" kind="output"': 'name="speed" kind="input"'},
        r"connector motor\.speed is 'input', but output in the FMU",
    ),
    "type": (
        {r'<ssc:Real unit="V"/>': "<ssc:Integer/>"},
        r"motor\.u is Integer, but Real in the FMU",
    ),
    "unit of a connector": (
        {r'<ssc:Real unit="rad/s"/>': '<ssc:Real unit="rpm"/>'},
        r"motor\.speed is in rpm, but in rad/s in the FMU; units are not converted",
    ),
    "transformation": (
        {
            r'endConnector="speed"/>': 'endConnector="speed"><ssc:LinearTransformation factor="2"/>'
            "</ssd:Connection>"
        },
        r"motor\.speed -> amplifier\.speed has a LinearTransformation \(factor 2, offset 0\)",
    ),
    "mapping": (
        {
            r'(source="resources/motor.ssv")/>': r"\1><ssd:ParameterMapping/>"
            "</ssd:ParameterBinding>"
        },
        r"a parameter binding has a mapping, which is not supported",
    ),
    "missing values": (
        {r"resources/motor\.ssv": "resources/moto.ssv"},
        r"a parameter binding refers to 'resources/moto\.ssv', which is not in the archive",
    ),
    "file outside": (
        {r"resources/the_motor\.fmu": "../the_motor.fmu"},
        r"motor refers to '\.\./the_motor\.fmu', which is not inside the archive",
    ),
    "file elsewhere": (
        {r"resources/the_motor\.fmu": "file:///etc/passwd"},
        r"motor refers to 'file:///etc/passwd', which is not inside the archive",
    ),
    "step": (
        {r'baseStepSize="0.01"': 'baseStepSize="0.03"'},
        r"second steps every 0\.04 s, no whole number of base steps of 0\.03 s",
    ),
    "number": ({r'stopTime="3.5"': 'stopTime="soon"'}, r"stopTime = 'soon' is no finite number"),
    "stop that is no number": ({r'stopTime="3.5"': 'stopTime="NaN"'}, r"stopTime = 'NaN' is no"),
    "start that is infinite": (
        {r'startTime="[^"]*"': 'startTime="-INF"'},
        r"startTime = '-INF' is",
    ),
    "no step": ({r'baseStepSize="0.01"': 'baseStepSize="0"'}, r"step = '0' must be above 0 s"),
    "step back": (
        {r'baseStepSize="0.01"': 'baseStepSize="-0.01"'},
        r"step = '-0.01' must be above",
    ),
    "step of no slave": (
        {r'StepSizeHint value="[^"]*"': 'StepSizeHint value="0"'},
        r"StepSizeHint = '0' must be above 0 s",
    ),
    "too large": ({r"$": " " * (32 * 2**20)}, r"SystemStructure\.ssd is larger than \d+ bytes"),
    "doctype": (
        {r"<ssd:SystemStr": '<!DOCTYPE a [<!ENTITY b "c">]><ssd:SystemStr'},
        r"SystemStructure\.ssd has a DOCTYPE",
    ),
    "xml": ({r"</ssd:System>": ""}, r"SystemStructure\.ssd is not valid XML"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", REFUSED)
def test_refused(ssp: Path, case: str) -> None:
    changes, message = REFUSED[case]
    with pytest.raises(FmuError, match=message):
        read_ssp(rewritten(ssp, changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({r'name="on"': 'name="onn"'}, r"no variable of 'second' 'onn'\. Did you mean 'on'\?"),
        ({r"<ssv:Boolean": "<ssv:Real"}, r"second\.on is Real, but Boolean in the FMU"),
        ({r'value="false"': 'value="no"'}, r"second\.on = 'no' is no finite number"),
        ({r'(<ssv:Real value="[^"]*")': r'\1 unit="rpm"'}, r"second\.initial\.speed is in rpm"),
        ({r"<ssv:Boolean[^>]*>": ""}, r"second\.on has no value"),
        ({r"<ssv:ParameterSet": "<!DOCTYPE a><ssv:ParameterSet"}, r"second\.ssv has a DOCTYPE"),
    ],
)
def test_refused_values(ssp: Path, changes: dict[str, str], message: str) -> None:
    with pytest.raises(FmuError, match=message):
        read_ssp(rewritten(ssp, changes, "resources/second.ssv"))


def test_unsafe_archives(tmp_path: Path, ssp: Path) -> None:
    def archive(add: Callable[[zipfile.ZipFile], None]) -> Path:
        path = tmp_path / "bad.ssp"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bad:
            bad.writestr(SSD, members(ssp)[SSD])
            add(bad)
        return path

    link = zipfile.ZipInfo("resources/link")
    link.external_attr = 0o120777 << 16
    cases: dict[str, Callable[[zipfile.ZipFile], None]] = {
        r"unsafe path in the archive: '\.\./evil'": lambda a: a.writestr("../evil", "x"),
        r"'resources/link' is a link": lambda a: a.writestr(link, "/etc/passwd"),
        r"twice": lambda a: a.writestr("systemstructure.SSD", "x"),
    }
    for message, add in cases.items():
        with pytest.raises(FmuError, match=rf"bad\.ssp: refused: .*{message}"):
            read_ssp(archive(add))
    assert not (tmp_path.parent / "evil").exists()
    (tmp_path / "text.ssp").write_text("no zip")
    with pytest.raises(FmuError, match=r"text\.ssp: not a readable SSP archive"):
        read_ssp(tmp_path / "text.ssp")
    with pytest.raises(FmuError, match=r"missing\.ssp: not a readable SSP archive"):
        read_ssp(tmp_path / "missing.ssp")
    with zipfile.ZipFile(tmp_path / "empty.ssp", "w") as empty:
        empty.writestr("readme.txt", "x")
    with pytest.raises(FmuError, match=rf"a zip archive without {SSD}"):
        read_ssp(tmp_path / "empty.ssp")
