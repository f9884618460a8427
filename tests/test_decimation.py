"""Meshes of fewer triangles: in order, and as near to the given ones as is told."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import ball_mesh, ball_volume, box_mesh, edge_counts, signed_volume

import recon3d
from recon3d.errors import ArgumentError
from recon3d.rendering.ray_caster import RayCaster
from recon3d.surface.decimation import decimate


def test_fewer_triangles_stay_closed_and_as_near_as_is_told() -> None:
    ball = ball_mesh(1.0, 40)
    fewer, decimation = decimate(ball, 1500)
    assert decimation is not None
    assert len(fewer.triangles) == decimation.triangles <= 1500
    assert decimation.triangles_before == len(ball.triangles)
    assert (edge_counts(fewer) == 2).all()
    assert fewer.has_vertex_normals()
    # A sphere of 1500 equal triangles has gaps of 0.004 between facets and surface.
    assert 0.0005 < decimation.typical_error < decimation.largest_error < 0.02
    assert signed_volume(fewer) == pytest.approx(signed_volume(ball), rel=0.01)
    points = np.random.default_rng(0).standard_normal((2000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    # The ball's own facets lie up to 0.0008 inside.
    assert RayCaster(fewer).distances(points).max() < decimation.largest_error + 0.001


def test_flat_faces_cost_nothing() -> None:
    box = box_mesh(1.0, 2.0, 3.0).subdivide_midpoint(3)
    fewer, decimation = decimate(box, 12)
    assert decimation is not None
    assert decimation.largest_error < 1e-6
    assert signed_volume(fewer) == pytest.approx(6.0)


def test_a_mesh_of_few_triangles_is_left_as_it_is() -> None:
    ball = ball_mesh(1.0, 8)
    fewer, decimation = decimate(ball, len(ball.triangles))
    assert decimation is None
    assert fewer is ball


def test_more_than_the_shape_can_do_without_is_refused() -> None:
    with pytest.raises(ArgumentError, match="expected triangles to be a whole number of at least 4, got 0"):
        decimate(ball_mesh(), 0)


def test_the_error_is_told_in_the_scenes_unit() -> None:
    _, decimation = decimate(ball_mesh(1.0, 40), 1500)
    assert decimation is not None
    assert " mm, the rest by at most " in decimation.told(10.0)
    assert "units (no scale)" in decimation.told(None)


def test_meshing_decimates_before_anything_is_measured() -> None:
    volume = ball_volume(1.1, 24)
    carved = recon3d.CarvedVolume.untouched(volume)
    carved.labels[volume.occupied] = recon3d.Label.HIDDEN
    whole, few = recon3d.mesh(carved), recon3d.mesh(carved, meshing=recon3d.Meshing(triangles=300))
    assert whole.decimation is None
    assert few.decimation is not None
    assert len(few.mesh.triangles) <= 300 < len(whole.mesh.triangles)
    assert len(few.measured) == len(few.mesh.vertices)
