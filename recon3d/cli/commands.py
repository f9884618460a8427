"""The command line: reads arguments, calls the library, says where things lie."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from recon3d._version import __version__
from recon3d.cli.arguments import (
    beside,
    load,
    make_method,
    mesh_of,
    names_of,
    numbers_of,
    photograph,
    pixel_of,
    progress,
    record_of,
    recorded_scene,
    recorded_settings,
    run,
    save,
    say,
    sweep_of,
    views_of,
    writable,
)
from recon3d.errors import ArgumentError, Recon3dError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Coloured, measured 3D models from calibrated photographs. Start with: recon3d demo",
)


class MatchingChoice(StrEnum):
    """Whether points are matched inside the carved voxels."""

    auto = "auto"
    none = "none"
    dense = "dense"


class Surface(StrEnum):
    """Ways from points to a mesh."""

    poisson = "poisson"
    graph_cut = "graph-cut"


class MeshFormat(StrEnum):
    """File formats of a mesh."""

    ply = "ply"
    obj = "obj"
    glb = "glb"
    stl = "stl"


SceneArgument = Annotated[
    str, typer.Argument(metavar="SCENE", help="Folder of calibrated photographs, or 'little-temple' (built in).")
]


OutputOption = Annotated[Path | None, typer.Option("--output", "-o", metavar="DIR", help="Folder for the results.")]


BoundsOption = Annotated[
    str | None,
    typer.Option(metavar="X0,Y0,Z0,X1,Y1,Z1", help="Box around the object in world units, if not the scene's own."),
]


SilhouettesOption = Annotated[
    str,
    typer.Option(
        metavar="auto|segmented|threshold|none|FOLDER",
        help="Masks of the object: auto takes the scene's own, or else segments the dark background.",
    ),
]


ViewsOption = Annotated[
    str,
    typer.Option(metavar="auto|all|NAME,NAME", help="auto: as many as the method admits; names may hold wildcards."),
]


UnitOption = Annotated[float, typer.Option(metavar="MM", help="Millimetres in one world unit (1000: metres).")]


PercentOption = Annotated[float, typer.Option(metavar="PERCENT", help="Share of the reconstruction for accuracy.")]


ThresholdOption = Annotated[float, typer.Option(metavar="MM", help="Distance that counts as complete.")]


ValidOption = Annotated[
    Path | None, typer.Option(metavar="MESH", help="The part of GROUND_TRUTH that is real data; the rest is filler.")
]


ValidWithinOption = Annotated[float, typer.Option(metavar="MM", help="How near to --valid counts as valid.")]


SeedOption = Annotated[int, typer.Option(help="Seed of the surface samples.")]


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    show_version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    context.obj = debug
    if show_version:
        typer.echo(f"recon3d {__version__}")
        raise typer.Exit


@app.command()
def demo(
    output: OutputOption = None,
    n_voxels: Annotated[int, typer.Option("--voxels", help="Approximate number of voxels.")] = 1_000_000,
    noise: Annotated[float, typer.Option(help="Sensor noise, grey levels.")] = 0.0,
    light_change: Annotated[float, typer.Option(help="Change of exposure between views, as a fraction.")] = 0.0,
) -> None:
    """Photograph the built-in little temple, reconstruct, measure and render it."""
    from recon3d.io.geometry import write_geometry
    from recon3d.io.middlebury import write_middlebury
    from recon3d.settings import Settings

    folder = writable(output or Path("recon3d-output/demo"))
    built_in = photograph("little-temple", noise=noise, light_change=light_change)
    photographs = write_middlebury(built_in.scene, folder / "photographs")
    scene = replace(built_in.scene, notes={"format": "Middlebury", "source": str(photographs.resolve())})
    truth = write_geometry(folder / "ground_truth.ply", built_in.ground_truth)
    result = run(scene, Settings(n_voxels=n_voxels), built_in.ground_truth)
    written = save(result, folder, ["ply"])
    say(result.summary())
    say({"photographs": photographs, "ground truth": truth, **written})


@app.command()
def info(
    scene: SceneArgument,
    output: OutputOption = None,
    bounds: BoundsOption = None,
    silhouettes: SilhouettesOption = "auto",
) -> None:
    """Say what a scene holds and which views can be used together; with --output, draw it."""
    from recon3d.carving.visibility import largest_admissible_views
    from recon3d.io.files import write_image
    from recon3d.io.middlebury import read_angles
    from recon3d.scene.silhouettes import overlay
    from recon3d.summary import thumbnails

    loaded = load(scene, bounds, silhouettes)
    admissible = largest_admissible_views(loaded)
    angles = read_angles(scene) if Path(scene).is_dir() else {}
    say(loaded.summary())
    say({"views for voxel colouring": f"{len(admissible)} of {len(loaded.views)} (ordinal visibility constraint)"})
    typer.echo()
    for view in loaded.views:
        angle = "lat {:.1f} lon {:.1f}".format(*angles[view.name]) if view.name in angles else ""
        use = "used" if view.name in admissible else "-"
        known = "silhouette" if view.has_silhouette else "no silhouette"
        typer.echo(f"  {view.name:24} {use:6} {known:14} {angle}".rstrip())
    if output:
        sheet = thumbnails((overlay(loaded, view) for view in loaded.views), width=320, columns=4)
        say({"silhouettes and bounds": write_image(output / "views.png", sheet)})


@app.command()
def reconstruct(
    scene: SceneArgument,
    output: OutputOption = None,
    n_voxels: Annotated[
        int | None, typer.Option("--voxels", help="Approximate number of voxels [default: 1000000].")
    ] = None,
    voxel_size: Annotated[float | None, typer.Option(help="Voxel size in world units, instead of --voxels.")] = None,
    method: Annotated[str, typer.Option(help="Carving method: auto or one of the README's table.")] = "auto",
    method_option: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Option of the method, such as connectivity=6; may be repeated."),
    ] = None,
    test: Annotated[
        str | None,
        typer.Option(help="Photo-consistency test, where the method uses one: a name such as fuzzy, or module:name."),
    ] = None,
    test_option: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Parameter of the test; may be repeated.")
    ] = None,
    views: ViewsOption = "auto",
    max_views: Annotated[int | None, typer.Option(help="With --views auto: at most so many.")] = None,
    fill_hidden: Annotated[bool, typer.Option("--fill-hidden", help="Mesh what lies hidden, too: solid.")] = False,
    matching: Annotated[
        MatchingChoice,
        typer.Option(
            help="Mesh of points that are matched inside the carved voxels (dense), or of the voxels themselves (none) "
            "[auto: dense where --method is auto and silhouettes are known]."
        ),
    ] = MatchingChoice.auto,
    surface: Annotated[Surface, typer.Option(help="How a dense mesh is made of its points.")] = Surface.poisson,
    keep_unsupported: Annotated[
        bool, typer.Option(help="Keep surface that nothing was measured of, the hull's, so that the mesh is closed.")
    ] = True,
    bounds: BoundsOption = None,
    silhouettes: SilhouettesOption = "auto",
    mm_per_unit: UnitOption = 1000.0,
    ground_truth: Annotated[Path | None, typer.Option(metavar="MESH", help="Measure against this mesh.")] = None,
    mesh_format: Annotated[list[MeshFormat] | None, typer.Option(help="May be repeated [default: ply].")] = None,
    pictures: Annotated[bool, typer.Option(help="Render comparison and turntable.")] = True,
) -> None:
    """Reconstruct a coloured mesh, points and voxels from calibrated photographs."""
    from recon3d.io.geometry import read_mesh
    from recon3d.settings import Settings
    from recon3d.stereo import PASSES
    from recon3d.surface import Meshing

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
            fill_hidden=fill_hidden,
        ),
    )
    truth = read_mesh(ground_truth) if ground_truth else None
    loaded = load(scene, bounds, silhouettes, mm_per_unit)
    folder = writable(output or Path("recon3d-output") / loaded.name)
    result = run(loaded, settings, truth, folder / "stages")
    written = save(result, folder, [name.value for name in mesh_format or [MeshFormat.ply]], pictures=pictures)
    say(result.summary())
    say(written)


@app.command()
def evaluate(
    reconstruction: Annotated[Path, typer.Argument(metavar="RECON", help="Result folder, mesh, points or voxels.")],
    ground_truth: Annotated[Path, typer.Argument(metavar="GROUND_TRUTH", help="Mesh or points, in the same frame.")],
    output: OutputOption = None,
    accuracy_percent: PercentOption = 90.0,
    completeness_threshold: ThresholdOption = 1.25,
    mm_per_unit: Annotated[
        float | None, typer.Option(metavar="MM", help="Millimetres in one world unit [default: the result's, or 1000].")
    ] = None,
    valid: ValidOption = None,
    valid_within: ValidWithinOption = 0.1,
    supported: Annotated[
        bool, typer.Option("--supported", help="Leave out what nothing was measured of and only the hull closes.")
    ] = False,
    error_scale: Annotated[float, typer.Option(metavar="MM", help="Distance that the error maps show red.")] = 5.0,
    seed: SeedOption = 0,
) -> None:
    """Measure a reconstruction: accuracy and completeness against a ground truth."""
    from open3d.geometry import TriangleMesh

    from recon3d.evaluation.files import evaluate_files
    from recon3d.io.geometry import read_geometry
    from recon3d.reporting.figures import save_evaluation
    from recon3d.reporting.pictures import save_error_maps

    folder = writable(output or beside(reconstruction, "evaluation"))
    record = record_of(reconstruction) if mm_per_unit is None else None
    unit = mm_per_unit or (record["mm_per_unit"] if record else 1000.0)
    with progress() as report:
        report("measuring", 0, 1)
        measured = evaluate_files(
            mesh_of(reconstruction),
            ground_truth,
            valid=valid,
            valid_within_mm=valid_within,
            supported=supported,
            mm_per_unit=unit,
            accuracy_percent=accuracy_percent,
            completeness_threshold_mm=completeness_threshold,
            seed=seed,
        )
        report("measuring", 1, 1)
    written = save_evaluation(measured, folder)
    files = mesh_of(reconstruction), ground_truth
    if all(isinstance(read_geometry(file), TriangleMesh) for file in files):
        with progress() as report:
            report("error maps", 0, 1)
            written |= save_error_maps(*files, folder, mm_per_unit=unit, full_scale_mm=error_scale)
            report("error maps", 1, 1)
    say(measured.summary())
    say(written)


@app.command()
def compare(
    scene: SceneArgument,
    tests: Annotated[
        str, typer.Option(metavar="all|NAME,NAME", help="Photo-consistency tests, built in or module:name.")
    ] = "all",
    output: OutputOption = None,
    sweep: Annotated[
        str | None,
        typer.Option(metavar="NAME=LOW:HIGH:STEP", help="Run the tests with this parameter at each of its values."),
    ] = None,
    n_voxels: Annotated[int, typer.Option("--voxels", help="Approximate number of voxels.")] = 1_000_000,
    method: Annotated[str, typer.Option(help="Carving method, the same for all.")] = "voxel-coloring",
    method_option: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Option of the method; may be repeated.")
    ] = None,
    views: ViewsOption = "auto",
    max_views: Annotated[int | None, typer.Option(help="At most so many views, after those left out.")] = None,
    leave_out: Annotated[
        str,
        typer.Option(
            metavar="N|NAME,NAME", help="Measure re-projection on every N-th view, or those named; 0: on all used."
        ),
    ] = "4",
    bounds: BoundsOption = None,
    silhouettes: SilhouettesOption = "auto",
    mm_per_unit: UnitOption = 1000.0,
    ground_truth: Annotated[Path | None, typer.Option(metavar="MESH", help="Measure against this mesh.")] = None,
    valid: ValidOption = None,
    valid_within: ValidWithinOption = 0.1,
    accuracy_percent: PercentOption = 90.0,
    completeness_threshold: ThresholdOption = 1.25,
) -> None:
    """Compare photo-consistency tests on the same voxels and views; what is finished is not run again."""
    from recon3d.evaluation.files import read_ground_truth
    from recon3d.settings import Settings
    from recon3d.study.comparison import compare
    from recon3d.study.variants import expand_variants

    chosen: Any = tests if tests == "all" else names_of(tests)
    swept = sweep_of(sweep) if sweep else None
    expand_variants(chosen, swept)  # a mistake here need not wait for the photographs
    settings = Settings(
        n_voxels=n_voxels,
        carving=make_method(method, method_option or [], None, []),
        views=views_of(views),
        max_views=max_views,
    )
    options: dict[str, Any] = {}
    if valid and not ground_truth:
        raise ArgumentError("--valid: expected --ground-truth, too")
    if ground_truth:
        truth, mask = read_ground_truth(
            ground_truth, valid=valid, valid_within_mm=valid_within, mm_per_unit=mm_per_unit
        )
        options = {
            "ground_truth": truth,
            "valid": mask,
            "accuracy_percent": accuracy_percent,
            "completeness_threshold_mm": completeness_threshold,
        }
    loaded = load(scene, bounds, silhouettes, mm_per_unit)
    folder = writable(output or Path("recon3d-output") / f"{loaded.name}-tests")
    with progress() as report:
        result = compare(
            loaded,
            chosen,
            settings=settings,
            sweep=swept,
            leave_out=int(leave_out) if leave_out.isdigit() else names_of(leave_out),
            folder=folder,
            progress=report,
            **options,
        )
        written = result.save(folder)
    typer.echo(result.markdown())
    say(written)


@app.command()
def render(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Folder of a result, or a mesh file.")],
    scene: Annotated[
        str | None, typer.Option(metavar="SCENE", help="Whose cameras to use, if not those the result records.")
    ] = None,
    output: OutputOption = None,
) -> None:
    """Render a result from its input cameras, beside the photographs, and from all around."""
    from recon3d.io.geometry import read_mesh
    from recon3d.reporting.pictures import save_pictures

    mesh = read_mesh(mesh_of(result))
    folder = writable(output or beside(result, "renders"))
    hint = ", so the cameras are not known; give --scene"
    loaded = load(scene, None, "none") if scene else recorded_scene(result, record_of(result), hint=hint)
    with progress() as report:
        report("rendering", 0, 1)
        written = save_pictures(mesh, loaded, folder, every_view=True)
        report("rendering", 1, 1)
    say(written)


@app.command()
def explain(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Folder of a result.")],
    at: Annotated[str | None, typer.Option(metavar="X,Y,Z", help="A place in the voxel, world units.")] = None,
    pixel: Annotated[
        str | None,
        typer.Option(
            metavar="VIEW,U,V",
            help="The surface that the pixel shows; where there is none, what came nearest to it on the ray.",
        ),
    ] = None,
    test: Annotated[
        str | None,
        typer.Option(metavar="MODULE:NAME", help="Your own test, if the result was made with it: run its code again."),
    ] = None,
    output: OutputOption = None,
) -> None:
    """Say why a voxel was carved or kept: carve once more as recorded, and draw what decided."""
    from recon3d.explaining.explanation import explain as explain_voxel
    from recon3d.io.checkpoints import Checkpoints
    from recon3d.io.files import write_image

    place, clicked = numbers_of("--at", at, "three numbers X,Y,Z"), pixel_of(pixel)
    if (place is None) == (clicked is None):
        raise ArgumentError("expected --at X,Y,Z or --pixel VIEW,U,V, one of them")
    record = record_of(result)
    settings = recorded_settings(result, record, test)
    scene = recorded_scene(result, record, silhouettes=record["silhouettes"] if record else "auto")
    folder = writable(output or beside(result, "explanations"))
    stages = beside(result, "stages")
    kept = Checkpoints(stages) if stages.is_dir() else None
    with progress() as report:
        report("carving", 0, 1)
        found = explain_voxel(scene, settings, at=place, pixel=clicked, checkpoints=kept)
        report("carving", 1, 1)
    kept_voxels = ("consistent", "hidden")
    if record and any(record["voxels"][name] != found.carved.counts()[name] for name in kept_voxels):
        warnings.warn(f"{result}: carved once more, other voxels are left than recorded; data or program have changed",
                      stacklevel=1)  # fmt: skip
    name = "voxel_" + "_".join(map(str, found.voxel)) + ".png"
    say(found.summary())
    say({"picture": write_image(folder / name, found.picture())})


def main() -> None:
    """Run a command; a known error is one line and exit code 1."""
    debug = "--debug" in sys.argv
    if debug:  # wherever it stands
        sys.argv = [sys.argv[0], *(argument for argument in sys.argv[1:] if argument != "--debug")]
    warnings.showwarning = lambda message, *_args, **_kw: typer.echo(f"Warning: {message}", err=True)
    try:
        app()
    except (Recon3dError, ValueError, OSError) as error:
        if debug:
            raise
        typer.echo(f"Error: {error}", err=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
