"""How far a mesh of matched points may be from the true surface, vertex by vertex."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import erf

from recon3d.scene.scene import Scene
from recon3d.surface.visibility import VertexVisibility

_NEAREST = 8  # points that a vertex is judged by

_REACH = 1.5  # pixel footprints over which a point's weight falls to 0.6

_FACING = 0.3  # cosine between the normals of a vertex and a point that speaks of it

_LEAST_COSINE = 0.1  # between normal and line of sight: no view counts as more slanted

_FARTHEST = 20.0  # pixel footprints of error for a pixel of disparity: fewer than two views, or hardly any baseline


class Constants(NamedTuple):
    """What the errors are multiplied with; see ``standard_deviation``."""

    disagreement: float
    matching: float
    scatter: float
    gap: float


FITTED = Constants(disagreement=2.84, matching=0.213, scatter=1.18, gap=0.0236)
"""By ``scripts/fit_uncertainty.py``; docs/uncertainty.md tells of which scenes, and how well."""


class Evidence(NamedTuple):
    """What the uncertainty of measured vertices is predicted from; lengths are in pixel footprints at the object."""

    shift: NDArray[np.float64]
    """(n,) how far single views' planes lie from the mean of those that agree, root mean square."""
    bend: NDArray[np.float64]
    """(n,) change of the mesh's normal, radians a footprint; an uneven mesh shows the noise that meshing left."""
    scatter: NDArray[np.float64]
    """(n,) height of the nearest points above or below the mesh, root mean square."""
    gap: NDArray[np.float64]
    """(n,) distance of the farthest of the nearest points: how many were fused here."""
    disparity: NDArray[np.float64]
    """(n,) error along the normal for an error of a pixel in every view that sees a vertex."""
    noise: NDArray[np.float64]
    """(n,) strength of what windows do not share over that of what they share, (1 - NCC^2) / NCC^2."""


def predict_uncertainty(
    mesh: o3d.geometry.TriangleMesh,
    points: o3d.t.geometry.PointCloud,
    scene: Scene,
    visibility: VertexVisibility,
    measured: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """(n_vertices,) distance to the true surface that 68% of vertices keep within, 95% within twice as much.

    World units; infinite where nothing was measured.

    Parameters
    ----------
    mesh : through the points, with vertex normals.
    points : as ``refine`` finds them.
    visibility : of the mesh's vertices in the scene's views.
    measured : (n_vertices,) whether the points measured a vertex.
    """
    uncertainty = np.full(len(mesh.vertices), np.inf)
    if measured.any():
        found = evidence(mesh, points, scene, visibility, measured)
        uncertainty[measured] = scene.pixel_footprint * standard_deviation(found)
    return uncertainty


def standard_deviation(found: Evidence, constants: Constants = FITTED) -> NDArray[np.float64]:
    """(n,) of the error of vertices, pixel footprints.

    Four independent errors add up. Views disagree, and what is left of that in their mean shows as an uneven mesh: the
    disagreement weighs with the root of the bend. Matching errs by pixels, the more the noisier the windows, and the
    baseline turns pixels into depth. Points scatter about the mesh. Where points are sparse, the mesh is made up
    between them, with an error that grows with the square of the gap, as that of a chord does.
    """
    errors = (
        constants.disagreement * found.shift * np.sqrt(found.bend),
        constants.matching * found.disparity * np.sqrt(found.noise),
        constants.scatter * found.scatter,
        constants.gap * found.gap**2,
    )
    return np.asarray(np.sqrt(np.sum(np.square(errors), axis=0)))


def evidence(
    mesh: o3d.geometry.TriangleMesh,
    points: o3d.t.geometry.PointCloud,
    scene: Scene,
    visibility: VertexVisibility,
    measured: NDArray[np.bool_],
) -> Evidence:
    """What is known of the measured vertices (n_vertices,) of a mesh; see ``predict_uncertainty``."""
    footprint = scene.pixel_footprint
    vertices, normals = np.asarray(mesh.vertices)[measured], np.asarray(mesh.vertex_normals)[measured]
    positions = points.point.positions.numpy()
    correlation, shift = (points.point[name].numpy().ravel() for name in ("correlation", "shift"))
    tree = cKDTree(positions)
    distance, nearest = tree.query(vertices, k=np.arange(1, min(_NEAREST, tree.n) + 1), workers=-1)
    facing = np.einsum("nki,ni->nk", points.point.normals.numpy()[nearest], normals) > _FACING
    weights = np.where(facing, np.exp(-0.5 * np.square(distance / (_REACH * footprint))), 0) + 1e-12
    weights /= weights.sum(axis=1, keepdims=True)
    height = np.einsum("nki,ni->nk", positions[nearest] - vertices[:, None], normals)
    disparity = triangulation(vertices, normals, scene, visibility.seen[:, measured])

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.einsum("nk,nk->n", weights, values))

    return Evidence(
        np.sqrt(mean(np.square(shift[nearest]))) / footprint,
        _bend(mesh)[measured] * footprint,
        np.sqrt(mean(np.square(height))) / footprint,
        distance[:, -1] / footprint,
        np.minimum(disparity / footprint, _FARTHEST),
        1 / np.maximum(mean(correlation[nearest]), 1e-3) - 1,
    )


def triangulation(
    points: NDArray[np.float64], normals: NDArray[np.float64], scene: Scene, seen: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """(n,) standard deviation along the normals of points (n, 3), for an error of a pixel in each view that sees them.

    World units; infinite where fewer than two views see a point (n_views, n). Moved along its normal n by h, a point
    is found at h t further on the surface by a view in direction d, with t = d / (d . n) - n. Where it is and how high
    follows from all views by least squares, each as exact as its footprint on the surface is small.

    References
    ----------
    Foerstner, Wrobel, "Photogrammetric computer vision", 2016, chapter 4 (least squares and its covariance).
    """
    weight, slope, square = np.zeros(len(points)), np.zeros((len(points), 3)), np.zeros(len(points))
    cameras = scene.cameras
    for center, focal, row in zip(cameras.centers, cameras.focals, seen, strict=True):
        toward = center - points[row]
        distance = np.linalg.norm(toward, axis=1)
        along = np.maximum(np.einsum("ij,ij->i", toward, normals[row]) / distance, _LEAST_COSINE)
        leaning = toward / (distance * along)[:, None] - normals[row]
        exactness = (along * focal / distance) ** 2
        weight[row] += exactness
        slope[row] += exactness[:, None] * leaning
        square[row] += exactness * np.square(leaning).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        information = square - np.square(slope).sum(axis=1) / weight
        deviation = 1 / np.sqrt(np.maximum(information, 0))
    return np.where(seen.sum(axis=0) >= 2, deviation, np.inf)


def predicted_distance(uncertainty: NDArray[np.float64], share: float = 0.9) -> float:
    """Distance within which a share of measured vertices should lie from the true surface, world units.

    Errors are taken for normally distributed, each with its uncertainty (n_vertices,) as standard deviation; infinite
    ones are left out. Infinite where all are.
    """
    finite = uncertainty[np.isfinite(uncertainty)]
    if not len(finite):
        return float("inf")
    low, high = 0.0, 10 * float(finite.max())
    for _ in range(30):
        middle = (low + high) / 2
        within = erf(middle / (np.sqrt(2) * finite)).mean()
        low, high = (middle, high) if within < share else (low, middle)
    return high


def _bend(mesh: o3d.geometry.TriangleMesh) -> NDArray[np.float64]:
    """(n_vertices,) change of the normal along the edges around each vertex, radians a world unit."""
    vertices, normals, triangles = (np.asarray(part) for part in (mesh.vertices, mesh.vertex_normals, mesh.triangles))
    turned, length = np.zeros((2, len(vertices)))
    for first, second in ((0, 1), (1, 2), (2, 0)):
        a, b = triangles[:, first], triangles[:, second]
        for values, total in ((normals, turned), (vertices, length)):
            squared = np.square(values[a] - values[b]).sum(axis=1)
            total += np.bincount(a, squared, len(vertices)) + np.bincount(b, squared, len(vertices))
    return np.asarray(np.sqrt(turned / np.maximum(length, 1e-300)))
