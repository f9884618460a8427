"""Places in an image for the triangles of a mesh."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from recon3d.errors import EmptyReconstructionError

_GUTTER = 4.0  # texels between charts
_PER_PART = 10_000  # triangles; larger parts have fewer seams, and take longer by more than their size


def unwrap(mesh: o3d.geometry.TriangleMesh, size: int) -> NDArray[np.float64]:
    """(n_triangles, 3, 2) places of the triangles' corners in a square image, in [0, 1]: to the right, downwards.

    Parameters
    ----------
    mesh : manifold.
    size : of the image, texels.

    Raises
    ------
    EmptyReconstructionError : the mesh cannot be laid flat.

    References
    ----------
    Zhou, Snyder, Guo, Shum, "Iso-charts: stretch-driven mesh parameterization using spectral analysis", SGP 2004, by
    Open3D and Microsoft's UVAtlas.
    """
    # It computes in single precision, in which a world far from its origin has no detail.
    middle = mesh.get_axis_aligned_bounding_box().get_center()
    extent = float(np.max(mesh.get_max_bound() - mesh.get_min_bound()))
    flat = o3d.t.geometry.TriangleMesh()
    flat.vertex.positions = o3d.core.Tensor.from_numpy(
        ((np.asarray(mesh.vertices) - middle) / extent).astype(np.float32)
    )
    flat.triangle.indices = o3d.core.Tensor.from_numpy(np.asarray(mesh.triangles).astype(np.int64))
    parts = max(round(len(mesh.triangles) / _PER_PART), 1)
    try:
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            flat.compute_uvatlas(size, gutter=_GUTTER, parallel_partitions=parts)
    except RuntimeError as error:
        said = " ".join(str(error).split())
        raise EmptyReconstructionError(f"the mesh could not be laid flat for a texture ({said})") from None
    return np.asarray(flat.triangle.texture_uvs.numpy(), np.float64)
