"""Compute device and threads: processor or GPU, one thread.

One thread: small matrices gain nothing from two, and are much slower on a shared machine; and
another order of summation gives other bytes, in numpy's BLAS as in torch.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from threadpoolctl import threadpool_limits

from twin.errors import ModelError

CPU = torch.device("cpu")  # the default


def device_named(name: str) -> torch.device:
    """The device of a name.

    Args:
        name: `cpu`; `cuda`: a GPU; `auto`: a GPU where torch finds one.

    Raises:
        ModelError: The name is unknown, or there is no GPU.
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


@contextmanager
def one_thread() -> Iterator[None]:
    """Context manager: torch and BLAS use one thread inside, and the previous number afterwards."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(before)
