from __future__ import annotations

from dataclasses import replace

import open3d as o3d
import pytest
from scenes import box_mesh, cameras, photographs, plain

from recon3d import Settings, VisualHull, reconstruct
from recon3d.evaluation.thin_parts import lost_thin_parts
from recon3d.scene.scene import Scene
from recon3d.scene.silhouettes import without_silhouettes

BODY = box_mesh(1.0, 1.0, 0.8).translate((0, 0, -0.6))
ROD = box_mesh(0.06, 0.06, 1.2).translate((0.066, 0.066, 0.4))  # two pixels wide, between centres of large voxels


@pytest.fixture(scope="module")
def flower() -> Scene:
    return photographs(BODY + ROD, plain, cameras(6, arc=360, width=240, height=180), supersampling=2)


def lost(scene: Scene, mesh: o3d.geometry.TriangleMesh, voxel_size: float) -> tuple[int, float] | None:
    found = lost_thin_parts(mesh, scene.views, scene.bounds, voxel_size)
    return None if found is None else (len(found.views), found.voxel_size)


def test_a_rod_that_the_mesh_lacks_is_told_with_voxels_that_keep_it(flower: Scene) -> None:
    found = lost(flower, BODY, 0.1)
    assert found is not None
    assert found[0] == 6
    # Seen across its sides or its corners, and with every pixel touched; two voxels or more across.
    assert 0.03 <= found[1] <= 0.05


def test_a_mesh_with_the_rod_lacks_nothing(flower: Scene) -> None:
    assert lost(flower, BODY + ROD, 0.1) is None


def test_nothing_is_told_of_a_rod_in_one_silhouette_or_without_silhouettes(flower: Scene) -> None:
    body = photographs(BODY, plain, [view.calibration for view in flower.views], supersampling=2)
    views = (flower.views[0], *body.views[1:])
    assert lost(replace(flower, views=views), BODY, 0.1) is None
    assert lost(without_silhouettes(flower), BODY, 0.1) is None


def test_a_thick_part_that_is_lacking_is_no_thin_one(flower: Scene) -> None:
    assert lost(flower, ROD, 0.1) is None


def test_a_reconstruction_names_the_views_and_the_voxel_size(flower: Scene) -> None:
    settings = Settings(carving=VisualHull(), matching=None, voxel_size=0.12)
    told = reconstruct(flower, settings).lost_parts()
    assert told is not None
    assert "not in the mesh (view01.png, view02.png, view03.png ...)" in told
    advised = float(told.partition("--voxel-size ")[2].split()[0])
    finer = reconstruct(flower, replace(settings, voxel_size=advised))
    assert finer.lost_parts() is None
