"""What the reader and the writer of `.ssp` files share: namespaces, file names, types."""

SSD_FILE = "SystemStructure.ssd"
NAMESPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
}
"""The prefixes matter: libcosim and ecos look for them literally."""
FMU_TYPE = "application/x-fmu-sharedlibrary"
SET_TYPE = "application/x-ssp-parameter-set"
PARAMETER_SET = "initialValues"
"""Name of all parameter sets that we write; ecos applies a set by name."""
OSP = "com.opensimulationplatform"
"""Annotations with the base step and the step of single slaves, read by libcosim."""


def tag(name: str) -> str:
    """`ssd:System` as lxml spells it."""
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"
