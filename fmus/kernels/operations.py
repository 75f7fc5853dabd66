"""A CasADi function as a list of scalar operations, each result with a number of its own."""

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True, slots=True)
class Operation:
    """One scalar operation.

    Attributes:
        code: CasADi's, such as `casadi.OP_ADD`.
        arguments: Numbers of the operations whose results it takes.
        place: Of an input: which argument of the function, and where in it.
        value: Of a constant.
    """

    code: int
    arguments: tuple[int, ...] = ()
    place: tuple[int, int] = (0, 0)
    value: float = 0.0


def operations(function: ca.Function) -> tuple[list[Operation], list[int]]:
    """What a function does, in order.

    Args:
        function: Of scalar operations (`SX`), with one dense result.

    Returns:
        Operations, each behind those whose results it takes; and which of them give the result.
    """
    found: list[Operation] = []
    latest: dict[int, int] = {}  # place in CasADi's work space -> operation that wrote it last
    results = [0] * function.nnz_out(0)
    for k in range(function.n_instructions()):
        code, given = function.instruction_id(k), function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            results[function.instruction_output(k)[1]] = latest[given[0]]
            continue
        if code == ca.OP_INPUT:
            operation = Operation(code, place=(given[0], given[1]))
        elif code == ca.OP_CONST:
            operation = Operation(code, value=function.instruction_constant(k))
        else:
            operation = Operation(code, tuple(latest[i] for i in given))
        latest[function.instruction_output(k)[0]] = len(found)
        found.append(operation)
    return found, results
