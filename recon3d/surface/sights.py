"""Which cameras see which places of a surface, and which two of them can measure a place together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon3d.kernels.vertex_colors import Vertices, facing_views
from recon3d.rendering.ray_caster import RayCaster
from recon3d.scene.camera import Camera
from recon3d.scene.packed import pack_cameras

_MIN_COSINE = 0.25  # between a normal and a line of sight along which a view can be matched
_ANGLES = (5.0, 50.0)  # degrees between two lines of sight that can be matched


@dataclass(frozen=True)
class Sights:
    """Which cameras see which places, and from where."""

    seen: NDArray[np.bool_]
    """(n_cameras, n)."""
    steep: NDArray[np.bool_]
    """(n_cameras, n) seen so that it can be matched."""
    toward: NDArray[np.float32]
    """(n_cameras, n, 3) unit, from the place to the camera."""

    @classmethod
    def of(
        cls, cameras: list[Camera], places: NDArray[np.float64], normals: NDArray[np.float64], caster: RayCaster,
        clearance: float,
    ) -> Sights:  # fmt: skip
        """Cast a line of sight from every camera to every place (n, 3) with a normal (n, 3).

        Parameters
        ----------
        caster : of what hides the places.
        clearance : before a place where its lines of sight end, world units.
        """
        packed = pack_cameras(cameras)
        seen = np.empty((len(cameras), len(places)), np.bool_)
        facing_views(Vertices(places, normals), packed, seen)
        ends = places + clearance * normals
        for row, center in zip(seen, packed.centers, strict=True):
            row[row] = ~caster.hidden(center, ends[row])
        toward = packed.centers[:, None] - places
        toward /= np.linalg.norm(toward, axis=2, keepdims=True)
        steep = seen & (np.einsum("cni,ni->cn", toward, normals) > _MIN_COSINE)
        return cls(seen, steep, toward.astype(np.float32))

    def part(self, places: NDArray[np.bool_]) -> Sights:
        """Of some of the places (n,)."""
        return Sights(self.seen[:, places], self.steep[:, places], self.toward[:, places])

    def matchable(self, other: Sights, index: int) -> NDArray[np.bool_]:
        """(n_cameras, n) places that a camera and one of another set's can measure together."""
        cosine = np.einsum("cni,ni->cn", self.toward, other.toward[index])
        nearest, farthest = np.cos(np.radians(_ANGLES))
        return np.asarray(self.steep & other.steep[index] & (cosine <= nearest) & (cosine >= farthest))
