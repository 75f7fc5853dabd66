"""Python-slave FMUs: a component evaluated by Python itself, behind pythonfmu's shared libraries.

For prototypes, and for models that cannot be converted to C. Such an FMU runs only in a Python
process with numpy and casadi: other hosts cannot load it (`undefined symbol: _Py_NoneStruct`).

All Python slaves of a process share its modules. So an FMU contains copies of all imported modules
of this project under names derived from its content, and two versions of a component do not
conflict.
"""

import hashlib
import json
import re
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import casadi as ca
from lxml import etree

from twin.component import Component
from twin.errors import FmuError, install_command

from ..builder import NAMESPACE, write_archive
from ..compensator import NetworkFile, interface_model
from ..description import model_description
from ..model import FmuModel, component_model

_ENTRY = '''\
"""pythonfmu reads this file again for each instance, and looks for the slave's class."""

from twin.{module} import {name}
from twin.script import keep

keep(globals())  # pythonfmu gives back a reference to them that it does not own
'''  # source of the slave's module
_IMPORTED = re.compile(r"^from (\.+)([\w.]*) import", re.MULTILINE)  # relative imports
_OURS = re.compile(r"^(from|import) (twin|pythonfmu)\b", re.MULTILINE)
"""Imports that are renamed."""


def build_python_slave(component: Component, path: Path) -> Path:
    """Build an FMI 2 co-simulation FMU that runs in a Python process.

    Args:
        component: Component of the FMU.
        path: File to write; its folder must exist.

    Returns:
        The path.

    Raises:
        FmuError: pythonfmu is not installed.
    """
    needs = f"numpy and casadi {ca.CasadiMeta.version()}"
    own = {"component.json": component_text(component).encode()}
    return _build(component_model(component), needs, "ComponentSlave", ("script",), own, path)


def build_network_slave(network: NetworkFile, path: Path) -> Path:
    """Build the Python-slave FMU of a compensator: the ONNX file itself, run by onnxruntime.

    Raises:
        FmuError: pythonfmu is not installed.
    """
    model = interface_model(network)
    needs, scripts = "numpy, casadi and onnxruntime", ("network", "script")
    own = {
        "network.json": _network_text(network, model).encode(),
        "model.onnx": network.content,
    }
    return _build(model, needs, "NetworkSlave", scripts, own, path)


def _build(
    model: FmuModel,
    needs: str,
    slave: str,
    scripts: tuple[str, ...],
    own: Mapping[str, bytes],
    path: Path,
) -> Path:
    """Build the archive of a model that Python evaluates.

    Args:
        model: Interface of the FMU.
        needs: Packages that the host needs.
        slave: Class of the first script that pythonfmu instantiates.
        scripts: Modules of this package that run in the FMU.
        own: Files that the scripts read.
        path: File to write.
    """
    try:
        libraries = resources.files("pythonfmu") / "resources" / "binaries"
    except ModuleNotFoundError as error:
        raise FmuError(
            f"{model.name}: a Python slave needs pythonfmu: {install_command('python-slave')}."
        ) from error
    text = f"{model.description}. Prototype: needs a Python host with {needs}"
    model = replace(model, description=text.lstrip(". "))
    binaries = {
        f"binaries/{platform}/{model.name}{suffix}": (libraries / platform / file).read_bytes()
        for platform, file, suffix in (
            ("linux64", "libpythonfmu-export.so", ".so"),
            ("win64", "pythonfmu-export.dll", ".dll"),
        )
    }
    files = _files(_ENTRY.format(module=scripts[0], name=slave), scripts, own)
    digest = _digest({"": _description(model, "")} | binaries | files)
    members = {
        "modelDescription.xml": _description(model, str(uuid.uuid5(NAMESPACE, digest))),
        **binaries,
        **_staged(files, digest[:16]),
    }
    write_archive(path, members)
    return path


def component_text(component: Component) -> str:
    """A component as JSON, with equations serialised by CasADi, without parts that `Run` does not
    use.

    `script.read_component` is the reader.
    """
    fields = asdict(replace(component, shortcuts=(), continuous=None))
    return json.dumps(fields, default=_function, allow_nan=False, indent=1)


def _function(value: Any) -> dict[str, str]:
    if isinstance(value, ca.Function):
        return {"casadi": ca.CasadiMeta.version(), "function": value.serialize()}
    raise TypeError(f"{value!r} does not travel in a Python slave.")


def _network_text(network: NetworkFile, model: FmuModel) -> str:
    """Data of `network` in addition to the ONNX file."""
    (part,) = model.parts
    content = {
        "name": model.name,
        "variables": [asdict(v) for v in part.variables],
        "states": part.state_names,
        "state_size": network.state_size,
        "n_commands": len(network.commands),
        "sensors": network.group_of_channel if network.sees_measurements else None,
        "uncorrected_rms": network.uncorrected_rms,
        "may_lack": sorted(part.may_lack),
    }
    return json.dumps(content, allow_nan=False, indent=1)


def _description(model: FmuModel, token: str) -> bytes:
    """Description of the native FMU, without features that a Python slave lacks."""
    root = etree.fromstring(
        model_description(model, 2, token, ()), etree.XMLParser(remove_blank_text=True)
    )
    (simulation,) = root.findall("CoSimulation")
    simulation.set("needsExecutionTool", "true")
    simulation.set("providesDirectionalDerivative", "false")
    for sources in simulation.findall("SourceFiles"):
        simulation.remove(sources)
    text: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return text


def _files(entry: str, scripts: Iterable[str], own: Mapping[str, bytes]) -> dict[str, bytes]:
    """Content of the resources folder, under names that are still the same in every FMU."""
    licence = metadata.distribution("pythonfmu").read_text("licenses/LICENSE") or ""
    ours = resources.files(__package__)
    texts = {
        "slave.py": entry,
        **{f"twin/{name}.py": (ours / f"{name}.py").read_text() for name in scripts},
        "pythonfmu/LICENSE": licence,
        **_modules("twin.component"),
        **_modules("pythonfmu.fmi2slave"),
    }
    files = {name: text.encode() for name, text in texts.items()}
    return files | {f"twin/{name}": content for name, content in own.items()}


def _modules(module: str) -> dict[str, str]:
    """Files of a module, of its parent packages, and of all its imports from there."""
    top = module.partition(".")[0]
    folder, found, wanted = resources.files(top), dict[str, str](), [module]
    while wanted:
        name = wanted.pop()
        path = "/".join(name.split(".")[1:])
        is_package = not path or (folder / path).is_dir()
        file = "/".join(filter(None, (path, "__init__"))) if is_package else path
        if f"{top}/{file}.py" in found:
            continue
        text = found[f"{top}/{file}.py"] = (folder / f"{file}.py").read_text()
        home = name.split(".") if is_package else name.split(".")[:-1]
        wanted.append(".".join(home))
        for dots, imported in _IMPORTED.findall(text):
            base = home[: len(home) + 1 - len(dots)]
            wanted.append(".".join(filter(None, (*base, imported))))
    return found


def _digest(contents: Mapping[str, bytes]) -> str:
    digest = hashlib.sha256()
    for name in sorted(contents):
        digest.update(f"{name}\0{len(contents[name])}\0".encode() + contents[name])
    return digest.hexdigest()


def _staged(files: Mapping[str, bytes], tag: str) -> dict[str, bytes]:
    """Archive members: each module under a unique name."""

    def content(name: str) -> bytes:
        """The file with imports of the others renamed."""
        if not name.endswith(".py"):
            return files[name]
        return _OURS.sub(rf"\1 \2_{tag}", files[name].decode()).encode()

    staged = {re.sub(r"^\w+", rf"resources/\g<0>_{tag}", name): content(name) for name in files}
    return {"resources/slavemodule.txt": f"slave_{tag}".encode(), **staged}
