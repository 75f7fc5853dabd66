"""Order of evaluation for connected slaves or parts, and algebraic loops among them."""

from collections.abc import Mapping, Set
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Loop:
    """Outputs, as "slave.output", that directly depend on themselves through each other."""

    outputs: tuple[str, ...]


Visit = str | Loop
"""A slave whose inputs are set and outputs read, or a loop to solve."""


def visits(dependencies: Mapping[str, Set[str]]) -> list[Visit]:
    """An order of evaluation after which every output is correct.

    A slave occurs twice where some of its outputs are needed before its inputs are known: an
    airframe outputs its position to a controller whose command enters its acceleration.

    Args:
        dependencies: Output -> the outputs on which it directly depends, through connected inputs.
            Outputs that are no keys are known beforehand.
    """
    order: list[Visit] = []
    remaining: dict[str, list[str]] = {}
    for output in dependencies:
        remaining.setdefault(slave_of(output), []).append(output)
    done: set[str] = set().union(*dependencies.values()) - dependencies.keys()
    while remaining:
        ready = {
            s: [o for o in outputs if dependencies[o] <= done] for s, outputs in remaining.items()
        }
        whole = [s for s, outputs in ready.items() if len(outputs) == len(remaining[s])]
        some = whole or [s for s, outputs in ready.items() if outputs]
        if some:
            order.append(some[0])
            done.update(ready[some[0]])
        else:
            loop = _first_loop(
                [o for outputs in remaining.values() for o in outputs], dependencies, done
            )
            order.append(loop)
            done.update(loop.outputs)
        left = {s: [o for o in outputs if o not in done] for s, outputs in remaining.items()}
        remaining = {s: outputs for s, outputs in left.items() if outputs}
    return order


def _first_loop(outputs: list[str], dependencies: Mapping[str, Set[str]], done: Set[str]) -> Loop:
    """A strongly connected component that depends only on itself."""
    from scipy.sparse import csr_array  # half a second to import, and loops are rare
    from scipy.sparse.csgraph import connected_components

    index = {o: i for i, o in enumerate(outputs)}
    edges = [(index[source], index[o]) for o in outputs for source in dependencies[o] - done]
    ones, (rows, columns) = np.ones(len(edges)), np.transpose(edges)
    graph = csr_array((ones, (rows, columns)), shape=(len(outputs), len(outputs)))
    count, label = connected_components(graph, directed=True, connection="strong")
    for k in range(count):
        members = tuple(o for o in outputs if label[index[o]] == k)
        if all(dependencies[o] <= done | set(members) for o in members):
            return Loop(members)
    raise AssertionError("a finite graph has a component without predecessors")


def slave_of(name: str) -> str:
    """Slave of "slave.variable"."""
    return name.partition(".")[0]
