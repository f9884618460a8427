from __future__ import annotations

import numpy as np
from scenes import full_volume, plain_view

from recon3d.carving.generalized import GeneralizedVoxelColoring
from recon3d.carving.item_buffer import ItemBuffer
from recon3d.scene.bounds import Bounds
from recon3d.scene.scene import Scene


def test_rays_that_enter_the_volume_at_an_occupied_voxel_hit_it() -> None:
    scene = Scene((plain_view(),), Bounds([-1, -1, -1], [1, 1, 1]))
    volume = full_volume((4, 4, 4), 0.5, (-1, -1, -1))
    buffer = ItemBuffer(scene.packed, volume)
    front = np.flatnonzero(np.arange(64) % 4 == 0)  # the camera looks along +z
    np.testing.assert_array_equal(buffer.advance(volume.occupied), front)
    assert not len(buffer.advance(volume.occupied))
    occupied = volume.occupied.copy()
    occupied[1, 2, 0] = False
    np.testing.assert_array_equal(buffer.advance(occupied), [(1 * 4 + 2) * 4 + 1])


def test_consistent_voxels_on_the_volumes_own_border_are_kept() -> None:
    scene = Scene((plain_view(),), Bounds([-1, -1, -1], [1, 1, 1]))
    hull = GeneralizedVoxelColoring().carve(scene, full_volume((4, 4, 4), 0.5, (-1, -1, -1)))
    assert hull.volume.occupied[:, :, 0].all()
