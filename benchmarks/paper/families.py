"""The families of the paper's comparison, as rows of `learning.model.registry`."""

from learning.model.registry import FamilyRow


def _system(name: str, member: str, meaning: str) -> FamilyRow:
    """A system of the paper's comparison; its preset has its name."""
    return FamilyRow(name, meaning, (name,), onnx=False, member=f"benchmarks.paper.{member}Family")


SYSTEMS = (
    _system("cvae", "autoencoders:Cvae", "a Gaussian latent per sample, given the phase"),
    _system("vqvae", "autoencoders:VqVae", "one hard codebook for all channels"),
    _system(
        "wgan",
        "adversarial:Wgan",
        "a generator with noise against a critic, no reconstruction term",
    ),
    _system("tsgan", "adversarial:TsGan", "noise and phase to a spectrogram, that to a series"),
    _system("vqgan", "autoencoders:VqGan", "`vqvae` with a patch critic"),
    _system(
        "cgan",
        "adversarial:Cgan",
        "LSTM generator and discriminator, after the one-line description",
    ),
    _system(
        "mrgan",
        "adversarial:MrGan",
        "a frozen regression guides `cgan`, after the one-line description",
    ),
    _system(
        "vqwwvae",
        "autoencoders:VqwwVae",
        "`vqvae` with a Wasserstein loss per channel, after the one-line description",
    ),
    _system(
        "tdm",
        "diffusing:Tdm",
        "diffusion, 50 cosine steps, gated convolutions, after the one-line description",
    ),
    _system(
        "timeddpm",
        "diffusing:TimeDdpm",
        "diffusion, 100 linear steps, U-Net, after the one-line description",
    ),
    _system("autofiltervq", "autoencoders:AutoFilterVq", "learned filters before a soft codebook"),
    _system(
        "contrastvq",
        "autoencoders:ContrastVq",
        "a soft codebook, and a contrastive loss between windows",
    ),
    _system("mcvq", "autoencoders:McVq", "slow and fast part with a soft codebook each"),
)
"""The thirteen that the paper compares its network with."""
ROWS = (
    FamilyRow(
        name="innovations",
        meaning="autoregression driven by its own innovations; it draws and corrects nothing",
        presets=("ar-codebook", "ar-gaussian", "white-noise"),
        onnx=False,
        member="benchmarks.paper.innovations:Innovations",
    ),
    *SYSTEMS,
)
