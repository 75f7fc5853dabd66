"""One thread: of torch and of BLAS, given back afterwards."""

import torch
from threadpoolctl import threadpool_info, threadpool_limits

from learning.compute import one_thread


def _blas() -> list[int]:
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_inside_there_is_one_and_afterwards_as_many_as_before() -> None:
    torch_before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        with threadpool_limits(2, user_api="blas"):
            before = _blas()
            with one_thread():
                assert torch.get_num_threads() == 1
                assert _blas() and set(_blas()) == {1}
            assert torch.get_num_threads() == 2
            assert before == _blas() and max(before) == 2
    finally:
        torch.set_num_threads(torch_before)
