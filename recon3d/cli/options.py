"""Arguments and options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

INPUT, CARVING, MATCHING, SURFACE = "Input", "Carving", "Matching", "Surface"
MEASURING, OUTPUT, ADVANCED = "Measuring", "Output", "Advanced"
"""Panels of the help, in this order."""


Scene = Annotated[
    str, typer.Argument(metavar="SCENE", help="Folder of calibrated photographs, or 'little-temple' (built in).")
]


SceneOrPhotographs = Annotated[
    str,
    typer.Argument(
        metavar="SCENE|PHOTOS", help="Folder of photographs, calibrated or not, or 'little-temple' (built in)."
    ),
]


Output = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="DIR", help="Folder for the results.", rich_help_panel=OUTPUT)
]


Bounds = Annotated[
    str | None,
    typer.Option(
        metavar="X0,Y0,Z0,X1,Y1,Z1",
        help="Box around the object in world units, if not the scene's own.",
        rich_help_panel=INPUT,
    ),
]


Object = Annotated[
    bool,
    typer.Option(
        "--object",
        help="Leave the table or ground that the object stands on out of bounds that are found from sparse points.",
        rich_help_panel=INPUT,
    ),
]


Board = Annotated[
    str | None,
    typer.Option(
        metavar="charuco-10x7:25mm",
        help="Printed board of recon3d board that the photographs show: gives cameras, millimetres, up and bounds.",
        rich_help_panel=INPUT,
    ),
]


Turntable = Annotated[
    str | None,
    typer.Option(
        metavar="step=10,distance=600,height=250,tilt=20",
        help="The photographs are of a turntable, in the order of their names: degrees from each to the next "
        "(counter-clockwise from above), the camera's distance from the axis and height above the platform in mm, and "
        "by how many degrees it looks down; focal= in pixels, if not EXIF's.",
        rich_help_panel=INPUT,
    ),
]


KnownDistance = Annotated[
    str | None,
    typer.Option(
        metavar="'IMAGE:U,V IMAGE:U,V = 120mm'",
        help="Scale of plain photographs: two points, each by its pixel in one photograph, or, more exact, in several "
        "(IMAGE:U,V+IMAGE:U,V), and what was measured between them.",
        rich_help_panel=INPUT,
    ),
]


Silhouettes = Annotated[
    str,
    typer.Option(
        metavar="auto|segmented|threshold|none|FOLDER",
        help="Masks of the object: auto takes the scene's own, or else cuts it out of a plain background.",
        rich_help_panel=INPUT,
    ),
]


Views = Annotated[
    str,
    typer.Option(
        metavar="auto|all|NAME,NAME",
        help="auto: as many as the method admits; names may hold wildcards.",
        rich_help_panel=INPUT,
    ),
]


Images = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="Folder of the photographs, if they are not with the cameras.", rich_help_panel=INPUT
    ),
]


Detail = Annotated[
    str,
    typer.Option(
        metavar="auto|full|half|quarter",
        help="Scale at which photographs are read; auto: the finest that keeps within the memory and ten CPU minutes.",
        rich_help_panel=INPUT,
    ),
]


Memory = Annotated[
    str | None,
    typer.Option(
        metavar="SIZE",
        help="Memory that a run may take, such as 4GiB or 800MB; what would take more is refused.",
        show_default="for --detail auto 4GiB, or half of the machine's",
        rich_help_panel=INPUT,
    ),
]


MmPerUnit = Annotated[
    float | None,
    typer.Option(
        metavar="MM",
        help="Millimetres in one world unit.",
        show_default="the format's, if it has a unit",
        rich_help_panel=INPUT,
    ),
]


Method = Annotated[
    str, typer.Option(help="Carving method: auto or one of the README's table.", rich_help_panel=CARVING)
]


MethodOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--method-option",
        metavar="NAME=VALUE",
        help="Option of the method, such as connectivity=6; may be repeated.",
        rich_help_panel=ADVANCED,
    ),
]


AccuracyPercent = Annotated[
    float,
    typer.Option(metavar="PERCENT", help="Share of the reconstruction for accuracy.", rich_help_panel=MEASURING),
]


CompletenessThreshold = Annotated[
    float, typer.Option(metavar="MM", help="Distance that counts as complete.", rich_help_panel=MEASURING)
]


Valid = Annotated[
    Path | None,
    typer.Option(
        metavar="MESH",
        help="The part of GROUND_TRUTH that is real data; the rest is filler.",
        rich_help_panel=MEASURING,
    ),
]


ValidWithin = Annotated[
    float, typer.Option(metavar="MM", help="How near to --valid counts as valid.", rich_help_panel=MEASURING)
]
