"""Minimum cut of lattice graphs, by search trees that are mended, not grown anew, after each augmenting path.

Boykov, Kolmogorov, "An experimental comparison of min-cut/max-flow algorithms for energy minimization in vision",
PAMI 2004. Arc d of a node leads to its d-th neighbour, and that one's arc d ^ 1 leads back.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels import kernel

FREE, SOURCE, SINK = 0, 1, 2
_TERMINAL, _ORPHAN = -1, -2  # parents that are no arc
_FAR = 2**30


# Columns of the nodes' state (n, 5):
_TREE = 0  # FREE, SOURCE or SINK
_PARENT = 1  # arc to the parent, or _TERMINAL or _ORPHAN
_DEPTH = 2  # nodes to the terminal, as they were at the time of the stamp
_STAMP = 3  # last time that the node was known to hang on a terminal
_WAITING = 4  # whether it is among those that may still grow


class Graph(NamedTuple):
    """What can flow where; k arcs lead from each of n nodes."""

    neighbours: NDArray[np.int32]
    """(n, k) node that an arc leads to, -1: none."""
    residual: NDArray[np.int32]
    """(n, k) what an arc can still carry."""
    terminal: NDArray[np.int32]
    """(n,) what the source can still send to a node or, negative, the node to the sink."""


class _Forest(NamedTuple):
    """The search trees of both terminals."""

    nodes: NDArray[np.int32]
    """(n, 5) state of every node."""
    active: NDArray[np.int32]
    """(n + 2,) ring of those that may still grow; the last two entries are its begin and its length."""
    orphans: NDArray[np.int32]
    """(n,) those that lost their parent."""


@kernel()
def min_cut(
    neighbours: NDArray[np.int32], residual: NDArray[np.int32], terminal: NDArray[np.int32], tree: NDArray[np.uint8]
) -> int:
    """Value of the maximum flow; ``tree`` (n,) becomes the side of every node, FREE where both cost the same.

    ``neighbours`` (n, k), -1: none. ``residual`` (n, k) and ``terminal`` (n,), what the source can send to a node or,
    negative, the node to the sink, are capacities below 2^30 before, and what is left of them after.
    """
    n = terminal.shape[0]
    nodes = np.zeros((n, 5), np.int32)
    active, orphans = np.empty(n + 2, np.int32), np.empty(n, np.int32)
    active[n:] = 0
    graph, forest = Graph(neighbours, residual, terminal), _Forest(nodes, active, orphans)
    for i in range(n):
        nodes[i, _DEPTH] = 1
        nodes[i, _PARENT] = _ORPHAN
        if terminal[i] != 0:
            nodes[i, _TREE] = SOURCE if terminal[i] > 0 else SINK
            nodes[i, _PARENT] = _TERMINAL
            _activate(forest, i)
    flow, time, i = 0, 0, _next_active(forest)
    while i >= 0:
        d = _grow(graph, forest, i)
        time += 1
        if d < 0:
            i = _next_active(forest)
            continue
        amount, n_orphans = _augment(graph, forest, i, d)
        flow += amount
        _adopt(graph, forest, n_orphans, time)
        if nodes[i, _TREE] == FREE:
            i = _next_active(forest)
    tree[:] = nodes[:, _TREE]
    return flow


@kernel()
def _activate(forest: _Forest, i: int) -> None:
    """Let a node grow, once more or for the first time."""
    nodes, active, _ = forest
    n = nodes.shape[0]
    if nodes[i, _WAITING] == 0:
        nodes[i, _WAITING] = 1
        active[(active[n] + active[n + 1]) % n] = i
        active[n + 1] += 1


@kernel()
def _next_active(forest: _Forest) -> int:
    """The node of a tree that has waited longest; -1: none."""
    nodes, active, _ = forest
    n = nodes.shape[0]
    while active[n + 1] > 0:
        i = int(active[active[n]])
        active[n] = (active[n] + 1) % n
        active[n + 1] -= 1
        nodes[i, _WAITING] = 0
        if nodes[i, _TREE] != FREE:
            return i
    return -1


@kernel()
def _room(residual: NDArray[np.int32], side: int, i: int, d: int, j: int) -> int:
    """What more can flow between node i and its neighbour j along arc d: from i in the source's tree, else to i."""
    return residual[i, d] if side == SOURCE else residual[j, d ^ 1]


@kernel()
def _grow(graph: Graph, forest: _Forest, i: int) -> int:
    """Take free neighbours into the node's tree; the arc that meets the other tree, -1 when there is none."""
    neighbours, residual, _ = graph
    nodes = forest.nodes
    side = nodes[i, _TREE]
    for d in range(neighbours.shape[1]):
        j = neighbours[i, d]
        if j < 0 or _room(residual, side, i, d, j) == 0:
            continue
        if nodes[j, _TREE] == FREE:
            nodes[j, _TREE] = side
            _activate(forest, j)
        elif nodes[j, _TREE] != side:
            return d
        elif nodes[j, _STAMP] > nodes[i, _STAMP] or nodes[j, _DEPTH] <= nodes[i, _DEPTH]:
            continue  # its own way to the terminal is as short
        nodes[j, _PARENT], nodes[j, _STAMP], nodes[j, _DEPTH] = d ^ 1, nodes[i, _STAMP], nodes[i, _DEPTH] + 1
    return -1


@kernel()
def _augment(graph: Graph, forest: _Forest, i: int, d: int) -> tuple[int, int]:
    """Send what fits through arc d of a node that meets the other tree: the amount, and how many it orphaned."""
    neighbours, residual, _ = graph
    j = neighbours[i, d]
    side = forest.nodes[i, _TREE]
    amount = min(_room(residual, side, i, d, j), _narrowest(graph, forest.nodes, i), _narrowest(graph, forest.nodes, j))
    outwards = amount if side == SOURCE else -amount
    residual[i, d] -= outwards
    residual[j, d ^ 1] += outwards
    n_orphans = _send(graph, forest, i, amount, 0)
    return amount, _send(graph, forest, j, amount, n_orphans)


@kernel()
def _narrowest(graph: Graph, nodes: NDArray[np.int32], i: int) -> int:
    """What can flow between a node and the terminal of its tree."""
    neighbours, residual, terminal = graph
    amount = _FAR
    while nodes[i, _PARENT] != _TERMINAL:
        d = nodes[i, _PARENT]
        j = neighbours[i, d]
        amount = min(amount, _room(residual, nodes[i, _TREE], j, d ^ 1, i))
        i = j
    return min(amount, abs(terminal[i]))


@kernel()
def _send(graph: Graph, forest: _Forest, i: int, amount: int, n_orphans: int) -> int:
    """Let an amount flow between a node and the terminal of its tree; how many orphans there are now."""
    neighbours, residual, terminal = graph
    nodes, _, orphans = forest
    side = nodes[i, _TREE]
    to_terminal = amount if side == SOURCE else -amount
    while nodes[i, _PARENT] != _TERMINAL:
        d = nodes[i, _PARENT]
        j = neighbours[i, d]
        residual[i, d] += to_terminal
        residual[j, d ^ 1] -= to_terminal
        if _room(residual, side, j, d ^ 1, i) == 0:
            nodes[i, _PARENT] = _ORPHAN
            orphans[n_orphans] = i
            n_orphans += 1
        i = j
    terminal[i] -= to_terminal
    if terminal[i] == 0:
        nodes[i, _PARENT] = _ORPHAN
        orphans[n_orphans] = i
        n_orphans += 1
    return n_orphans


@kernel()
def _adopt(graph: Graph, forest: _Forest, n_orphans: int, time: int) -> None:
    """Find every orphan a new parent in its tree, or set it free and orphan its children."""
    neighbours, residual, _ = graph
    nodes, _, orphans = forest
    first = 0
    while n_orphans > 0:
        i = orphans[first]
        first = (first + 1) % orphans.shape[0]
        n_orphans -= 1
        if _found_parent(graph, nodes, i, time):
            continue
        for d in range(neighbours.shape[1]):
            j = neighbours[i, d]
            if j < 0 or nodes[j, _TREE] != nodes[i, _TREE]:
                continue
            if _room(residual, nodes[i, _TREE], j, d ^ 1, i) > 0:
                _activate(forest, j)
            if nodes[j, _PARENT] == d ^ 1:
                nodes[j, _PARENT] = _ORPHAN
                orphans[(first + n_orphans) % orphans.shape[0]] = j
                n_orphans += 1
        nodes[i, _TREE] = FREE


@kernel()
def _found_parent(graph: Graph, nodes: NDArray[np.int32], i: int, time: int) -> bool:
    """Whether an orphan could be hung on the neighbour that is nearest to the terminal."""
    neighbours, residual, _ = graph
    side, nearest, best = nodes[i, _TREE], _FAR, _ORPHAN
    for d in range(neighbours.shape[1]):
        j = neighbours[i, d]
        if j < 0 or nodes[j, _TREE] != side or _room(residual, side, j, d ^ 1, i) == 0:
            continue
        length = _terminal_distance(neighbours, nodes, j, time)
        if length < nearest:
            nearest, best = length, d
        while length < _FAR and nodes[j, _STAMP] != time:  # remembered for the others that ask now
            nodes[j, _STAMP], nodes[j, _DEPTH] = time, length
            length -= 1
            j = neighbours[j, nodes[j, _PARENT]]
    nodes[i, _PARENT] = best
    if best == _ORPHAN:
        return False
    nodes[i, _STAMP], nodes[i, _DEPTH] = time, nearest + 1
    return True


@kernel()
def _terminal_distance(neighbours: NDArray[np.int32], nodes: NDArray[np.int32], i: int, time: int) -> int:
    """Nodes between a node and the terminal that it hangs on, itself among them; _FAR below an orphan."""
    length = 0
    while nodes[i, _STAMP] != time:
        length += 1
        if nodes[i, _PARENT] == _TERMINAL:
            nodes[i, _STAMP], nodes[i, _DEPTH] = time, 1
            return length
        if nodes[i, _PARENT] == _ORPHAN:
            return _FAR
        i = neighbours[i, nodes[i, _PARENT]]
    return length + nodes[i, _DEPTH]
