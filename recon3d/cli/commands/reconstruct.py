"""``recon3d reconstruct``."""

from __future__ import annotations

import warnings
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from recon3d.checks import require_whole
from recon3d.cli import options
from recon3d.cli.arguments import make_method, views_of
from recon3d.cli.console import run, say
from recon3d.cli.options import ADVANCED, CARVING, INPUT, MATCHING, MEASURING, OUTPUT, SURFACE
from recon3d.cli.results import save, save_texture, writable
from recon3d.cli.scenes import (
    at_detail,
    calibrated,
    doubts,
    load,
    plain_photographs,
    warn_of_findings,
    with_adjusted_cameras,
)
from recon3d.errors import ArgumentError


class _Matching(StrEnum):
    """Whether points are matched inside the carved voxels."""

    auto = "auto"
    none = "none"
    dense = "dense"


class _Surface(StrEnum):
    """Ways from points to a mesh."""

    poisson = "poisson"
    graph_cut = "graph-cut"


class _MeshFormat(StrEnum):
    """File formats of a mesh."""

    ply = "ply"
    obj = "obj"
    glb = "glb"
    stl = "stl"
    threemf = "3mf"


def command(
    scene: options.SceneOrPhotographs,
    refine_cameras: Annotated[
        bool,
        typer.Option(
            "--refine-cameras",
            help="Adjust the given cameras to matches between the photographs first (bundle adjustment).",
            rich_help_panel=INPUT,
        ),
    ] = False,
    views: options.Views = "auto",
    max_views: Annotated[
        int | None, typer.Option(help="With --views auto: at most so many.", rich_help_panel=INPUT)
    ] = None,
    silhouettes: options.Silhouettes = "auto",
    images: options.Images = None,
    bounds: options.Bounds = None,
    object_alone: options.Object = False,
    board: options.Board = None,
    turntable: options.Turntable = None,
    known_distance: options.KnownDistance = None,
    mm_per_unit: options.MmPerUnit = None,
    detail: options.Detail = "auto",
    memory: options.Memory = None,
    n_voxels: Annotated[
        int | None,
        typer.Option("--voxels", help="Approximate number of voxels.", show_default="1000000", rich_help_panel=CARVING),
    ] = None,
    voxel_size: Annotated[
        float | None, typer.Option(help="Voxel size in world units, instead of --voxels.", rich_help_panel=CARVING)
    ] = None,
    method: options.Method = "auto",
    test: Annotated[
        str | None,
        typer.Option(
            help="Photo-consistency test, where the method uses one: a name such as fuzzy, or module:name.",
            rich_help_panel=CARVING,
        ),
    ] = None,
    matching: Annotated[
        _Matching,
        typer.Option(
            help="dense: mesh of points that are matched inside the carved voxels; none: of the voxels themselves; "
            "auto: dense where --method is auto.",
            rich_help_panel=MATCHING,
        ),
    ] = _Matching.auto,
    surface: Annotated[
        _Surface, typer.Option(help="How a mesh is made of matched points.", rich_help_panel=SURFACE)
    ] = _Surface.poisson,
    keep_unsupported: Annotated[
        bool | None,
        typer.Option(
            help="Keep surface that was not measured, filled from the hull, so that the mesh is closed.",
            show_default="where silhouettes are known",
            rich_help_panel=SURFACE,
        ),
    ] = None,
    max_uncertainty: Annotated[
        float | None,
        typer.Option(
            metavar="D",
            help="Leave out surface that may be farther than this from the truth, world units; see uncertainty.",
            rich_help_panel=SURFACE,
        ),
    ] = None,
    triangles: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="At most so many triangles in the mesh; how far that moves the surface is told.",
            rich_help_panel=SURFACE,
        ),
    ] = None,
    ground_truth: Annotated[
        Path | None, typer.Option(metavar="MESH", help="Measure against this mesh.", rich_help_panel=MEASURING)
    ] = None,
    output: options.Output = None,
    mesh_format: Annotated[
        list[_MeshFormat] | None,
        typer.Option(
            help="May be repeated; stl and 3mf are for printing: millimetres, z up, closed meshes alone.",
            show_default="ply",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    texture: Annotated[
        int | None,
        typer.Option(
            metavar="TEXELS",
            help="Make a texture of this width and height, too: GLB, and OBJ with MTL and PNG, in metres, y up.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Render comparison and turntable.", rich_help_panel=OUTPUT)] = True,
    method_option: options.MethodOptions = None,
    test_option: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Parameter of the test; may be repeated.", rich_help_panel=ADVANCED),
    ] = None,
    fill_hidden: Annotated[
        bool,
        typer.Option(
            "--fill-hidden",
            help="With a one-sided method: mesh what lies hidden behind the accepted voxels, too; solid.",
            rich_help_panel=ADVANCED,
        ),
    ] = False,
    smoothing: Annotated[
        int | None,
        typer.Option(
            help="Pairs of Taubin steps on a mesh of voxels; 0: none.", show_default="5", rich_help_panel=ADVANCED
        ),
    ] = None,
    min_component: Annotated[
        float,
        typer.Option(
            help="Area, in faces of a voxel, below which a separate piece of the mesh is dropped; 0 keeps all.",
            rich_help_panel=ADVANCED,
        ),
    ] = 100.0,
) -> None:
    """Reconstruct a coloured mesh, points and voxels from photographs; plain ones are calibrated first."""
    from recon3d.io.printing import PRINT_SUFFIXES
    from recon3d.io.reading_geometry import read_mesh
    from recon3d.io.refined_cameras import REFINED_FILE
    from recon3d.reporting.saving import save_prints
    from recon3d.settings import Settings
    from recon3d.stereo import PASSES
    from recon3d.surface import Meshing, texture_mesh
    from recon3d.surface.texture import LARGEST_SIZE, LEAST_SIZE

    if texture is not None:
        require_whole("--texture", texture, LEAST_SIZE, LARGEST_SIZE)
    settings = Settings(
        views=views_of(views),
        max_views=max_views,
        n_voxels=n_voxels,
        voxel_size=voxel_size,
        carving=make_method(method, method_option or [], test, test_option or []),
        matching={"auto": "auto", "none": None, "dense": PASSES}[matching.value],
        meshing=Meshing(
            surface=surface.value,
            keep_unsupported=keep_unsupported,
            max_uncertainty=max_uncertainty,
            fill_hidden=fill_hidden,
            smoothing=smoothing,
            min_component=min_component,
            triangles=triangles,
        ),
    )
    truth = read_mesh(ground_truth) if ground_truth else None
    if images is None and (photographs := plain_photographs(scene)):
        if object_alone and bounds is not None:
            raise ArgumentError("the bounds are given (--bounds): no table can be left out of them (--object)")
        folder = writable(output or Path("recon3d-output") / Path(scene).resolve().name)
        found = calibrated(
            photographs, folder / "scene", board, turntable, None, known_distance, object_alone=object_alone
        )
        say(found.summary())
        with doubts() as doubted:
            loaded = load(str(folder / "scene"), bounds, silhouettes, mm_per_unit)
    elif any(option is not None for option in (board, turntable, known_distance)):
        raise ArgumentError(
            f"{scene} has its own cameras; --board, --turntable and --known-distance are for photographs alone"
        )
    else:
        with doubts() as doubted:
            loaded = load(scene, bounds, silhouettes, mm_per_unit, images, object_alone=object_alone)
        folder = writable(output or Path("recon3d-output") / loaded.name)
    if object_alone:
        say({"bounds": loaded.notes.get("bounds", "the format's own")})
    chosen = at_detail(loaded, detail, memory, settings)
    whole, loaded = loaded, chosen.scene
    if refine_cameras:
        loaded = with_adjusted_cameras(loaded, folder)
    else:
        (folder / REFINED_FILE).unlink(missing_ok=True)
    warn_of_findings(loaded, doubted)
    result = run(loaded, settings, truth, folder / "stages")
    formats = [each.value for each in mesh_format or [_MeshFormat.ply]]
    for_printing = [name for name in formats if f".{name}" in PRINT_SUFFIXES]
    written = save(result, folder, sorted(set(formats) - set(for_printing)) or ["ply"], pictures=pictures)
    say({**result.summary(), "detail": chosen.told})
    say(written)
    if texture is not None:
        # Smaller photographs keep the matching short; the texture is read from the whole ones.
        shown = result.scene if refine_cameras else whole.subset([view.name for view in result.scene.views])
        textured = texture_mesh(result.mesh, shown, size=texture)
        say(textured.summary())
        say(save_texture(textured, folder))
    if doubt := result.doubt():
        warnings.warn(f"{loaded.name}: {doubt}", stacklevel=1)
    elif lost := result.lost_parts():
        warnings.warn(f"{loaded.name}: {lost}", stacklevel=1)
    if for_printing:  # last, since an open mesh is refused
        say(save_prints(result, folder, for_printing))
