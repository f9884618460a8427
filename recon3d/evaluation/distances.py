"""Accuracy and completeness of a reconstruction against a ground truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import ArgumentError
from recon3d.evaluation.triangles import nearest_triangles
from recon3d.rendering.ray_caster import RayCaster
from recon3d.summary import Summarised
from recon3d.volume.dense import CarvingVolume

Shape = o3d.geometry.TriangleMesh | o3d.geometry.PointCloud | o3d.geometry.VoxelGrid | CarvingVolume


SAMPLES_PER_DIAGONAL = 1000
"""Samples lie about this fraction of the ground truth's bounding-box diagonal apart."""


MOST_SAMPLES = 1e8
"""More samples of one mesh than this are a mistake."""


MEASURED_SHARE = 4
"""Distances are measured from every fourth sample of a mesh."""


@dataclass(frozen=True, repr=False)
class Evaluation(Summarised):
    """Both directions of the distance between a reconstruction R and a ground truth G, in millimetres."""

    accuracy_distances: NDArray[np.float64]
    """(n,) from samples of R to G, ascending."""
    completeness_distances: NDArray[np.float64]
    """(m,) from samples of G to R, ascending."""
    accuracy_percent: float = 90.0
    """Share of R that the accuracy speaks of."""
    completeness_threshold_mm: float = 1.25
    """Distance that counts as covered."""
    left_out: int = 0
    """Samples of R that lie nearest to parts of G that are filler."""

    @property
    def accuracy_mm(self) -> float:
        """Distance within which ``accuracy_percent`` of R lies from G; smaller is better."""
        return self.accuracy_at(self.accuracy_percent)

    @property
    def completeness_percent(self) -> float:
        """Share of G that lies within ``completeness_threshold_mm`` of R; larger is better."""
        return self.completeness_at(self.completeness_threshold_mm)

    @property
    def precision_percent(self) -> float:
        """Share of R that lies within ``completeness_threshold_mm`` of G; larger is better."""
        right = np.searchsorted(self.accuracy_distances, self.completeness_threshold_mm, side="right")
        return 100.0 * int(right) / len(self.accuracy_distances)

    def accuracy_at(self, percent: float) -> float:
        """Distance in mm within which a percentage of R lies from G (nearest rank)."""
        rank = int(np.ceil(percent / 100 * len(self.accuracy_distances) - 1e-9))
        return float(self.accuracy_distances[max(rank, 1) - 1])

    def completeness_at(self, threshold_mm: float) -> float:
        """Percentage of G within a distance of R."""
        covered = np.searchsorted(self.completeness_distances, threshold_mm, side="right")
        return 100.0 * int(covered) / len(self.completeness_distances)

    def curves(self, n: int = 100) -> dict[str, list[float]]:
        """Both cumulative distributions, in percent, at n distances up to the larger 99% quantile."""
        largest = max(np.quantile(self.accuracy_distances, 0.99), np.quantile(self.completeness_distances, 0.99))
        distance = np.linspace(0, max(float(largest), self.completeness_threshold_mm), n)

        def percent_within(sorted_distances: NDArray[np.float64]) -> list[float]:
            within = np.searchsorted(sorted_distances, distance, side="right")
            return [float(x) for x in 100.0 * within / len(sorted_distances)]

        return {
            "distance_mm": [float(x) for x in distance],
            "reconstruction_within_percent": percent_within(self.accuracy_distances),
            "ground_truth_within_percent": percent_within(self.completeness_distances),
        }

    def headline(self) -> str:
        """Accuracy and completeness in a line."""
        return (
            f"accuracy {self.accuracy_mm:.3g} mm ({self.accuracy_percent:g}%), completeness "
            f"{self.completeness_percent:.1f}% (within {self.completeness_threshold_mm:g} mm)"
        )

    def summary(self) -> dict[str, object]:
        """Table of the figures."""
        return {
            f"accuracy ({self.accuracy_percent:g}% of R)": f"{self.accuracy_mm:.3g} mm",
            f"completeness ({self.completeness_threshold_mm:g} mm)": f"{self.completeness_percent:.1f}%",
            "median distance R to G": f"{self.accuracy_at(50):.3g} mm",
            "mean distance R to G": f"{self.accuracy_distances.mean():.3g} mm",
            "mean distance G to R": f"{self.completeness_distances.mean():.3g} mm",
        }

    def record(self) -> dict[str, object]:
        """The figures for a JSON file."""
        return {
            "accuracy_percent": self.accuracy_percent,
            "accuracy_mm": self.accuracy_mm,
            "completeness_threshold_mm": self.completeness_threshold_mm,
            "completeness_percent": self.completeness_percent,
            "median_mm": self.accuracy_at(50),
            "mean_reconstruction_to_ground_truth_mm": float(self.accuracy_distances.mean()),
            "mean_ground_truth_to_reconstruction_mm": float(self.completeness_distances.mean()),
            "reconstruction_samples": len(self.accuracy_distances),
            "ground_truth_samples": len(self.completeness_distances),
            "samples_left_out": self.left_out,
        }


def evaluate(
    reconstruction: Shape,
    ground_truth: o3d.geometry.TriangleMesh | o3d.geometry.PointCloud,
    *,
    mm_per_unit: float = 1000.0,
    accuracy_percent: float = 90.0,
    completeness_threshold_mm: float = 1.25,
    valid: NDArray[np.bool_] | None = None,
    spacing: float | None = None,
    seed: int = 0,
) -> Evaluation:
    """Measure a reconstruction R against a ground truth G as the Middlebury benchmark does.

    Meshes are sampled uniformly by area; of a point cloud the points and of a voxel grid the centres of its surface
    voxels are taken as they are. Distances run from these to the other mesh's triangles, right to 1%, or to the
    other's points or centres; both by Open3D's KD-tree.

    Parameters
    ----------
    reconstruction : mesh, point cloud, voxel grid or carving volume in the ground truth's frame and unit.
    ground_truth : mesh or point cloud.
    mm_per_unit : millimetres in one world unit of both.
    accuracy_percent : share of R, in (0, 100].
    completeness_threshold_mm : covered distance.
    valid : (n_triangles,) or (n_points,) of G; False marks filler such as a closed hole. Completeness is not asked
        there, and samples of R nearest to it are left out. All valid when None.
    spacing : mean distance of neighbouring samples, world units; a thousandth of G's box diagonal when None.
    seed : of the sampling.

    References
    ----------
    Seitz, Curless, Diebel, Scharstein, Szeliski, "A comparison and evaluation of multi-view stereo reconstruction
    algorithms", CVPR 2006, section 5.
    """
    if not 0 < accuracy_percent <= 100:
        raise ArgumentError(f"expected an accuracy percentage in (0, 100], got {accuracy_percent}")
    if not (0 < completeness_threshold_mm < np.inf and 0 < mm_per_unit < np.inf):
        raise ArgumentError(
            f"expected a positive completeness threshold and mm_per_unit, got {completeness_threshold_mm} "
            f"and {mm_per_unit}"
        )
    return measure(reconstruction, ground_truth, valid=valid, spacing=spacing, seed=seed).evaluation(
        mm_per_unit, accuracy_percent, completeness_threshold_mm
    )


@dataclass(frozen=True)
class Distances:
    """Distances between a reconstruction R and a ground truth G, with what they lead to; world units."""

    to_g: NDArray[np.float64]
    """(n,) from samples of R to G."""
    owners: NDArray[np.int64]
    """(n,) triangle or element of R that each sample lies on."""
    to_r: NDArray[np.float64]
    """(m,) from samples of G to R."""
    nearest: NDArray[np.int64]
    """(m,) triangle or element of R that each is nearest to."""
    samples_g: NDArray[np.float64]
    """(m, 3)."""
    left_out: int
    """Samples of R that lie nearest to parts of G that are filler, and are none of the n."""

    def evaluation(
        self, mm_per_unit: float = 1000.0, accuracy_percent: float = 90.0, completeness_threshold_mm: float = 1.25
    ) -> Evaluation:
        """Both distributions, in millimetres."""
        return Evaluation(
            np.sort(self.to_g) * mm_per_unit,
            np.sort(self.to_r) * mm_per_unit,
            accuracy_percent,
            completeness_threshold_mm,
            self.left_out,
        )

    def of_part(self, mesh: o3d.geometry.TriangleMesh, part: NDArray[np.bool_]) -> Distances:
        """Those of some triangles (n_triangles,) of the mesh R, on which a sample lies.

        Only what is nearest to the other triangles is measured again.
        """
        ours, elsewhere = part[self.owners], ~part[self.nearest]
        to_r, nearest = self.to_r.copy(), self.nearest.copy()
        if elsewhere.any():
            kept = np.flatnonzero(part)
            triangles = o3d.utility.Vector3iVector(np.asarray(mesh.triangles)[kept])
            alone = o3d.geometry.TriangleMesh(mesh.vertices, triangles)
            squared, triangle = nearest_triangles(self.samples_g[elsewhere], alone)
            to_r[elsewhere], nearest[elsewhere] = np.sqrt(squared), kept[triangle]
        return Distances(self.to_g[ours], self.owners[ours], to_r, nearest, self.samples_g, 0)


def measure(
    reconstruction: Shape,
    ground_truth: o3d.geometry.TriangleMesh | o3d.geometry.PointCloud,
    *,
    valid: NDArray[np.bool_] | None = None,
    spacing: float | None = None,
    seed: int = 0,
) -> Distances:
    """The distances behind ``evaluate``, from samples (n, 3) of each to the other; the parameters are the same."""
    if ground_truth.is_empty():
        raise ArgumentError(f"the {type(ground_truth).__name__} to evaluate against is empty")
    if spacing is None:
        diagonal = np.linalg.norm(ground_truth.get_max_bound() - ground_truth.get_min_bound())
        spacing = float(diagonal) / SAMPLES_PER_DIAGONAL
    if not 0 < spacing < np.inf:
        raise ArgumentError(f"expected a positive spacing of the samples, got {spacing}")
    rng = np.random.default_rng(seed)
    samples_g, owner_g = sample_surface(ground_truth, spacing, rng)
    samples_r, owner_r = sample_surface(reconstruction, spacing, rng)
    # Stratified samples come in the order of the triangles, so that every fourth is as even as all.
    step_g, step_r = (
        MEASURED_SHARE if isinstance(shape, o3d.geometry.TriangleMesh) else 1
        for shape in (ground_truth, reconstruction)
    )
    if valid is None:
        valid_g = np.ones(len(samples_g), np.bool_)
    else:
        n_owners = len(
            ground_truth.triangles if isinstance(ground_truth, o3d.geometry.TriangleMesh) else ground_truth.points
        )
        if valid.shape != (n_owners,) or valid.dtype != np.bool_ or not valid.any():
            raise ArgumentError(
                f"expected a bool mask ({n_owners},) with a True in it, got {valid.shape} {valid.dtype}"
            )
        valid_g = valid[owner_g]

    to_g, nearest = _distances(samples_r[::step_r], ground_truth, samples_g)
    kept = valid[nearest] if valid is not None else np.ones(len(to_g), np.bool_)
    if not kept.any():
        raise ArgumentError("every sample of the reconstruction lies nearest to filler: are both in one frame?")
    measured_g = samples_g[valid_g][::step_g]
    to_r, nearest_r = _distances(measured_g, reconstruction, samples_r)
    return Distances(to_g[kept], owner_r[::step_r][kept], to_r, nearest_r, measured_g, int(np.count_nonzero(~kept)))


def triangles_near(
    mesh: o3d.geometry.TriangleMesh, data: o3d.geometry.TriangleMesh, distance: float
) -> NDArray[np.bool_]:
    """(n_triangles,) which triangles' centroids lie within a distance of another mesh: a ``valid`` mask."""
    centroids = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)].mean(axis=1)
    return np.asarray(distance_to_mesh(centroids, data) <= distance)


def distance_to_mesh(points: NDArray[np.float64], mesh: o3d.geometry.TriangleMesh) -> NDArray[np.float64]:
    """(n,) exact distances of points (n, 3) to a mesh's triangles, world units."""
    return RayCaster(mesh).distances(points)


def sample_surface(
    shape: Shape, spacing: float, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points (n, 3) on a shape, and the triangle or element (n,) each comes from.

    A mesh gets area / spacing^2 points, uniform by area, at least one; others give their own points.
    """
    if isinstance(shape, o3d.geometry.VoxelGrid):
        shape = CarvingVolume.from_voxel_grid(shape)
    if isinstance(shape, CarvingVolume):
        points = shape.centers(shape.surface())
    elif isinstance(shape, o3d.geometry.PointCloud):
        points = np.asarray(shape.points)
    else:
        return _sample_mesh(shape, spacing, rng)
    if not len(points):
        raise ArgumentError(f"the {type(shape).__name__} to evaluate is empty")
    return points, np.arange(len(points))


def _sample_mesh(
    mesh: o3d.geometry.TriangleMesh, spacing: float, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    if not len(corners):
        raise ArgumentError("the mesh to evaluate has no triangles")
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    wanted = float(area.sum()) / spacing**2
    if not wanted < MOST_SAMPLES:
        raise ArgumentError(
            f"measuring would take {wanted:.3g} samples of a mesh; expected two shapes of about one size: "
            "are both in one unit, and finite?"
        )
    n = max(round(wanted), 1)
    # Stratified along the cumulated area, so that the density is even and every large triangle is met.
    position = (np.arange(n) + rng.random(n)) * (area.sum() / n)
    owner = np.minimum(np.searchsorted(np.cumsum(area), position, side="right"), len(area) - 1)
    # Square root of one uniform number: uniform over a triangle (Osada et al., "Shape distributions", 2002).
    root, other = np.sqrt(rng.random((n, 1))), rng.random((n, 1))
    a, b, c = (corners[owner, vertex] for vertex in range(3))
    return (1 - root) * a + root * (1 - other) * b + root * other * c, owner


def _distances(
    points: NDArray[np.float64], shape: Shape, elements: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(n,) distances of points (n, 3) to the nearest triangle of a mesh or element of another shape, and which it is.

    Elements (m, 3) are what ``sample_surface`` gives of a shape other than a mesh.
    """
    if isinstance(shape, o3d.geometry.TriangleMesh):
        squared, triangle = nearest_triangles(points, shape)
        return np.sqrt(squared), triangle
    search = o3d.core.nns.NearestNeighborSearch(o3d.core.Tensor.from_numpy(elements))
    search.knn_index()
    index, distances = (x.numpy().ravel() for x in search.knn_search(o3d.core.Tensor.from_numpy(points), 1))
    return np.sqrt(distances), index
