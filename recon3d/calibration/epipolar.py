"""Whether matches agree with cameras."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_tree, connected_components

from recon3d.calibration.colmap import load_pycolmap

MAX_DISTANCE = 4.0
"""Pixels between a match and its epipolar line, up to which it agrees."""

_SHARE = 0.8  # of a pair's matches that must agree


def essential_matrix(b_from_a: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) E with x_b^T E x_a = 0 for the rays of one point, from a (4, 4) rigid transform."""
    x, y, z = b_from_a[:3, 3] / max(float(np.linalg.norm(b_from_a[:3, 3])), 1e-12)
    return np.asarray(np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ b_from_a[:3, :3])


def sampson_distances(
    E: NDArray[np.float64], rays_a: NDArray[np.float64], rays_b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) distances between matched rays (n, 3) of depth one and their epipolar lines, in focal lengths."""
    lines_b, lines_a = rays_a @ E.T, rays_b @ E
    gradient = np.linalg.norm(np.hstack([lines_b[:, :2], lines_a[:, :2]]), axis=1)
    return np.asarray(np.abs((rays_b * lines_b).sum(axis=1)) / np.maximum(gradient, 1e-12))


def firmly_joined(path: Path, model: Any) -> set[str]:
    """Names of the images of a model that its matches hold together.

    A pair of images agrees where most of its verified matches lie near their epipolar lines. Images stay together
    that agreeing pairs join, more than one to any part: what hangs on a single pair may stand anywhere.

    Parameters
    ----------
    path : the database with the verified matches.
    """
    names = [image.name for image in model.images.values() if image.has_pose]
    agreeing = [(names.index(a), names.index(b)) for a, b in _agreeing_pairs(path, model)]
    parts = _without_bridges(len(names), agreeing)
    largest = np.bincount(parts).argmax() if names else -1
    return {name for name, part in zip(names, parts, strict=True) if part == largest}


def _agreeing_pairs(path: Path, model: Any) -> Iterable[tuple[str, str]]:
    pycolmap = load_pycolmap()
    placed = {image.name: image for image in model.images.values() if image.has_pose}
    database = pycolmap.Database.open(path)
    try:
        known = {image.image_id: image.name for image in database.read_all_images()}
        for pair_id, geometry in zip(*database.read_two_view_geometries(), strict=True):
            ids = pycolmap.pair_id_to_image_pair(pair_id)
            first, second = (known[n] for n in ids)
            matches = np.asarray(geometry.inlier_matches, np.int64).reshape(-1, 2)
            if len(matches) == 0 or first not in placed or second not in placed:
                continue
            images = placed[first], placed[second]
            cameras = [model.cameras[image.camera_id] for image in images]
            rays = []
            for side, (n, camera) in enumerate(zip(ids, cameras, strict=True)):
                pixels = np.asarray(database.read_keypoints(n), np.float64)[matches[:, side], :2]
                rays.append(np.column_stack([camera.cam_from_img(pixels), np.ones(len(matches))]))
            a, b = (np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]]) for image in images)
            distances = sampson_distances(essential_matrix(b @ np.linalg.inv(a)), *rays)
            if np.mean(distances * cameras[0].mean_focal_length() < MAX_DISTANCE) >= _SHARE:
                yield first, second
    finally:
        database.close()


def _without_bridges(n_nodes: int, edges: Sequence[tuple[int, int]]) -> NDArray[np.int64]:
    """(n_nodes,) the part that each node belongs to when every edge is taken away that alone joins two parts."""

    def components(kept: Sequence[tuple[int, int]]) -> tuple[int, NDArray[np.int64], coo_array]:
        a, b = np.array(kept, np.int64).reshape(-1, 2).T
        graph = coo_array((np.ones(len(kept)), (a, b)), shape=(n_nodes, n_nodes))
        count, parts = connected_components(graph, directed=False)
        return count, parts, graph

    if n_nodes == 0:
        return np.zeros(0, np.int64)
    count, parts, graph = components(edges)
    spanning: set[frozenset[int]] = set()  # bridges are among the edges of any spanning forest
    for part in range(count):
        root = int(np.flatnonzero(parts == part)[0])
        tree = breadth_first_tree(graph.tocsr(), root, directed=False).tocoo()
        spanning |= {frozenset(map(int, edge)) for edge in zip(*tree.coords, strict=True)}
    bridges = {
        edge for edge in spanning if components([other for other in edges if frozenset(other) != edge])[0] > count
    }
    return components([edge for edge in edges if frozenset(edge) not in bridges])[1].astype(np.int64)
