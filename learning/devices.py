"""Where a network is trained: on the processor, or on a GPU where torch finds one."""

import torch

from twin.errors import ModelError

CPU = torch.device("cpu")


def device_named(name: str) -> torch.device:
    """The device of a name.

    Args:
        name: `cpu`; `cuda`: a GPU; `auto`: a GPU where torch finds one.

    Raises:
        ModelError: Another name, or there is no GPU.
    """
    if name not in ("cpu", "cuda", "auto"):
        raise ModelError(f"device {name!r}: there are cpu, cuda and auto")
    if name == "cpu" or (name == "auto" and not torch.cuda.is_available()):
        return CPU
    if not torch.cuda.is_available():
        raise ModelError(
            f"device cuda: torch {torch.__version__} finds no GPU; train on the processor "
            "(cpu, auto), or install a torch that is built for this machine's GPU"
        )
    return torch.device("cuda", torch.cuda.current_device())
