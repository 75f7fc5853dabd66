"""The families of compensators: one row each; `train`, `evaluate` and the folder go by this table.

A family is a member of `learning.families` with its preset, and its row here. Nothing is imported
before it is used.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

from twin.errors import ModelError

from ..preset import Protocol

if TYPE_CHECKING:
    from .family import Family, FamilyPreset


@dataclass(frozen=True, slots=True)
class FamilyRow:
    """One family.

    Attributes:
        name: As written in `model.json`.
        meaning: What its models are, in a line.
        presets: Names of its presets, no two families have one in common.
        onnx: Whether its models are exported as `model.onnx`, and so as FMUs.
        member: `MODULE:CLASS` below `learning`, imported when used.
        otherwise: Preset where nobody says, "": the first.
    """

    name: str
    meaning: str
    presets: tuple[str, ...]
    onnx: bool
    member: str
    otherwise: str = ""

    @property
    def usual(self) -> str:
        """Preset where nobody says."""
        return self.otherwise or self.presets[0]

    def load(self) -> "Family[Any, Any]":
        """The family itself."""
        module, _, name = self.member.partition(":")
        family = getattr(import_module(f"..{module}", __package__), name)
        return cast("Family[Any, Any]", family())


def _system(name: str, kind: str, meaning: str) -> FamilyRow:
    """A system of the paper's comparison; its preset is called as it is."""
    return FamilyRow(name, meaning, (name,), onnx=False, member=f"systems.{name}:{kind}Family")


FAMILIES: tuple[FamilyRow, ...] = (
    FamilyRow(
        name="svq",
        meaning="FC-MC-SVQ network over the linear prediction",
        presets=("paper", "published", "best"),
        onnx=True,
        member="families.svq:Svq",
        otherwise="best",
    ),
    FamilyRow(
        name="linear",
        meaning="the linear prediction alone: what the network has to beat",
        presets=("linear",),
        onnx=False,
        member="families.linear:Linear",
    ),
    FamilyRow(
        name="trivial",
        meaning="the baselines of every evaluation, kept as models",
        presets=(
            "none",
            "mean",
            "last",
            "average",
            "last-reading",
            "autoregression",
            "mean-reading",
            "linear-in-inputs",
        ),
        onnx=False,
        member="families.trivial:Trivial",
    ),
    FamilyRow(
        name="innovations",
        meaning="autoregression driven by what it cannot say; it draws and corrects nothing",
        presets=("ar-codebook", "ar-gaussian", "white-noise"),
        onnx=False,
        member="families.innovations:Innovations",
    ),
    _system("cvae", "Cvae", "a Gaussian latent per sample, given the phase"),
    _system("vqvae", "VqVae", "one hard codebook for all channels"),
    _system("wgan", "Wgan", "a generator with noise against a critic, no reconstruction term"),
    _system("tsgan", "TsGan", "noise and phase to a spectrogram, that to a series"),
    _system("vqgan", "VqGan", "`vqvae` with a patch critic"),
    _system("cgan", "Cgan", "LSTM generator and discriminator, after the one-line description"),
    _system("mrgan", "MrGan", "a frozen regression guides `cgan`, after the one-line description"),
    _system(
        "vqwwvae",
        "VqwwVae",
        "`vqvae` with a Wasserstein loss per channel, after the one-line description",
    ),
    _system(
        "tdm",
        "Tdm",
        "diffusion, 50 cosine steps, gated convolutions, after the one-line description",
    ),
    _system(
        "timeddpm", "TimeDdpm", "diffusion, 100 linear steps, U-Net, after the one-line description"
    ),
    _system("autofiltervq", "AutoFilterVq", "learned filters before a soft codebook"),
    _system(
        "contrastvq", "ContrastVq", "a soft codebook, and latents that know their window again"
    ),
    _system("mcvq", "McVq", "slow and fast part with a soft codebook each"),
)
UNSAID = "svq"
"""Family of a folder from before there were others, and of whom nobody says it."""
_ONCE = {"fc_mc_svq": "svq"}
"""Names that families had before."""


def family_row(name: str) -> FamilyRow:
    """The family of that name."""
    for row in FAMILIES:
        if row.name == _ONCE.get(name, name):
            return row
    raise ModelError(f"no family {name!r}; there are {', '.join(r.name for r in FAMILIES)}")


def preset_named(name: str) -> "tuple[FamilyRow, FamilyPreset]":
    """The family that has a preset of that name, and the preset."""
    for row in FAMILIES:
        if name in row.presets:
            return row, row.load().presets()[name]
    known = (p for row in FAMILIES for p in row.presets)
    raise ModelError(f"no preset {name!r}; there are {', '.join(known)}")


def chosen(model: str | None, preset: str | None) -> "tuple[FamilyRow, FamilyPreset]":
    """The family and its preset, by the name of either or of both.

    Args:
        model: Of the family; None: that of the preset, or the first.
        preset: None: what the family takes where nobody says.

    Raises:
        ModelError: There is none of that name, or the preset is of another family.
    """
    if model is None and preset is not None:
        return preset_named(preset)
    row = family_row(UNSAID if model is None else model)
    if preset is not None and preset not in row.presets:
        raise ModelError(
            f"model {row.name} has the presets {', '.join(row.presets)}, no {preset!r}"
        )
    return row, row.load().presets()[preset or row.usual]


def check_preset(row: FamilyRow, preset: "FamilyPreset", protocol: Protocol) -> None:
    """Raise ModelError unless the preset can be trained under the protocol."""
    possible = row.load().protocols(preset)
    if protocol not in possible:
        raise ModelError(
            f"preset {preset.name}: not under protocol {protocol}, only under "
            f"{' and '.join(possible)}"
        )
