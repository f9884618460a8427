from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_flow

from recon3d.kernels.min_cut import SINK, min_cut
from recon3d.kernels.splatting import OrientedPoints, splat_planes
from recon3d.kernels.types import Votes

FACES = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])


def lattice_neighbours(mask: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(n, 6) face neighbours of a mask's voxels among themselves, -1 where none, one voxel at a time."""
    number = {tuple(voxel): n for n, voxel in enumerate(np.argwhere(mask).tolist())}
    return np.array(
        [[number.get(tuple(np.add(voxel, step).tolist()), -1) for step in FACES] for voxel in number], np.int32
    )


def maximum_flow_value(
    neighbours: NDArray[np.int32], capacities: NDArray[np.int32], terminal: NDArray[np.int32]
) -> int:
    """The same by scipy, whose arcs have no place for an empty neighbour."""
    n = len(terminal)
    tail, arc = np.nonzero(neighbours >= 0)
    every = np.arange(n)
    rows = np.concatenate([tail, np.full(n, n), every])
    columns = np.concatenate([neighbours[tail, arc], every, np.full(n, n + 1)])
    data = np.concatenate([capacities[tail, arc], np.maximum(terminal, 0), np.maximum(-terminal, 0)])
    return int(maximum_flow(csr_matrix((data.astype(np.int32), (rows, columns)), (n + 2, n + 2)), n, n + 1).flow_value)


def cut_value(
    neighbours: NDArray[np.int32], capacities: NDArray[np.int32], terminal: NDArray[np.int32], source: NDArray[np.bool_]
) -> int:
    """What leads from the source's side to the sink's."""
    across = (neighbours >= 0) & source[:, None] & ~source[neighbours]
    return int(
        capacities[across].sum() + np.maximum(terminal, 0)[~source].sum() - np.minimum(terminal, 0)[source].sum()
    )


@pytest.mark.parametrize("largest", [1, 3, 50, 10_000])
def test_the_cut_is_as_cheap_as_the_maximum_flow_is_large(largest: int) -> None:
    rng = np.random.default_rng(largest)
    for _ in range(60):
        mask = rng.random(rng.integers(1, 8, 3)) < 0.9
        mask[0, 0, 0] = True
        neighbours = lattice_neighbours(mask)
        capacities = rng.integers(0, largest + 1, neighbours.shape).astype(np.int32)
        terminal = rng.integers(-2 * largest, 2 * largest + 1, len(neighbours)).astype(np.int32)
        terminal[rng.random(len(terminal)) < rng.random()] = 0
        tree = np.empty(len(terminal), np.uint8)
        value = min_cut(neighbours, capacities.copy(), terminal.copy(), tree)
        assert value == maximum_flow_value(neighbours, capacities, terminal)
        # Free nodes may be on either side.
        assert value == cut_value(neighbours, capacities, terminal, tree == 1)
        assert value == cut_value(neighbours, capacities, terminal, tree != SINK)


def test_the_cut_goes_through_the_narrowest_face_of_a_chain() -> None:
    neighbours = lattice_neighbours(np.ones((1, 1, 5), np.bool_))
    capacities = np.where(neighbours >= 0, 9, 0).astype(np.int32)
    capacities[2, 4] = 4  # from the third to the fourth
    terminal = np.array([7, 0, 0, 0, -8], np.int32)
    tree = np.empty(5, np.uint8)
    assert min_cut(neighbours, capacities, terminal, tree) == 4
    np.testing.assert_array_equal(tree != SINK, [True, True, True, False, False])


def test_splatted_planes_are_gaussian_sums() -> None:
    rng = np.random.default_rng(0)
    shape, sigma, radius = (6, 5, 7), 0.8, 2
    points = rng.uniform(-2, 8, (40, 3)).astype(np.float32)  # some beside the lattice
    normals, weights = rng.standard_normal((40, 3)).astype(np.float32), rng.random(40).astype(np.float32)
    support, distance = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    splat_planes(OrientedPoints(points, normals, weights), sigma, radius, Votes(distance, support))
    expected, behind = np.zeros(shape), np.zeros(shape)
    for voxel in np.ndindex(shape):
        for point, normal, weight in zip(points.astype(float), normals, weights, strict=True):
            if (np.abs(np.floor(point + 0.5) - voxel) <= radius).all():
                share = weight * np.exp(-0.5 * ((point - voxel) ** 2).sum() / sigma**2)
                expected[voxel] += share
                behind[voxel] += share * (point - voxel) @ normal
    np.testing.assert_allclose(support, expected, atol=1e-5)
    np.testing.assert_allclose(distance, behind, atol=1e-5)
