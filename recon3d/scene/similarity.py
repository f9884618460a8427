"""Transforms between world frames of different unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Similarity:
    """The transform X -> scale * R X + t from one world frame to another."""

    scale: float
    R: NDArray[np.float64]
    """(3, 3) rotation."""
    t: NDArray[np.float64]
    """(3,) in units of the frame that it leads to."""

    @classmethod
    def identity(cls) -> Similarity:
        """What leaves everything where it is."""
        return cls(1.0, np.eye(3), np.zeros(3))

    @classmethod
    def between(cls, source: NDArray[np.float64], target: NDArray[np.float64], *, scaling: bool = True) -> Similarity:
        """What takes points (n, 3) to others (n, 3) with the least squared distance; without scaling a rigid one.

        References
        ----------
        S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 13(4),
        1991.
        """
        middle, aim = source.mean(axis=0), target.mean(axis=0)
        U, singular, Vt = np.linalg.svd((target - aim).T @ (source - middle) / len(source))
        signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
        R = U @ np.diag(signs) @ Vt
        spread = float(((source - middle) ** 2).sum(axis=1).mean())
        scale = float(singular @ signs) / spread if scaling and spread > 0 else 1.0
        return cls(scale, R, aim - scale * R @ middle)

    def __call__(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (n, 3) in the frame that it leads to."""
        return np.asarray(self.scale * points @ self.R.T + self.t)

    def inverse(self) -> Similarity:
        """The way back."""
        return Similarity(1 / self.scale, self.R.T, -self.R.T @ self.t / self.scale)

    def camera(self, cam_from_world: NDArray[np.float64]) -> NDArray[np.float64]:
        """(4, 4) pose of a camera in the frame that it leads to, from that in the other (4, 4): the pictures stay."""
        pose = np.eye(4)
        pose[:3, :3] = cam_from_world[:3, :3] @ self.R.T
        pose[:3, 3] = self.scale * cam_from_world[:3, 3] - pose[:3, :3] @ self.t
        return pose

    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) of homogeneous points."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.scale * self.R, self.t
        return matrix

    def __str__(self) -> str:
        degrees = np.degrees(np.arccos(np.clip((np.trace(self.R) - 1) / 2, -1, 1)))
        return f"scale {self.scale:.6g}, turned by {degrees:.3g} degrees, moved by {np.linalg.norm(self.t):.3g}"
