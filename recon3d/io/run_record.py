"""What ``record.json`` in the folder of a result holds, checked as it is read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType, field

from recon3d.errors import DataError

FORMAT = 1
"""Version of the record that runs write; a higher one is refused. Records of before versions were told are of 1."""

RECORD_FILE = "record.json"

_MOST_BYTES = 64 << 20

Count = Annotated[int, Meta(ge=0)]
Positive = Annotated[float, Meta(gt=0)]
Amount = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Percent = Annotated[float, Meta(ge=0, le=100)]
Point = tuple[float, float, float]


class SceneRecord(msgspec.Struct, frozen=True):
    """The scene that was reconstructed; what its format told besides is not listed here."""

    name: str
    views: Annotated[list[str], Meta(min_length=1)]
    """Names of the views that were used."""
    bounds: tuple[Point, Point]
    """Lowest and highest corner of the object's box, world units."""
    mm_per_unit: Positive | None
    """None: the scale is not known."""
    source: str | None = None
    """File, folder or name that the scene was opened from; None: it was made in Python."""
    silhouettes: str = field(name="silhouettes from", default="auto")
    """As ``--silhouettes`` takes it."""
    images: str | None = field(name="images from", default=None)
    """Folder of the photographs, where it was given."""
    detail: Literal["full", "half", "quarter"] = "full"
    """How large the photographs were read, as ``--detail`` takes it."""

    def __post_init__(self) -> None:
        low, high = self.bounds
        if not all(a < b for a, b in zip(low, high, strict=True)):
            raise ValueError("expected bounds whose first corner is the lower one in all three directions")


class VolumeRecord(msgspec.Struct, frozen=True):
    """The carved volume."""

    shape: tuple[Count, Count, Count]
    """Voxels along x, y, z."""
    voxel_size: Positive
    """World units."""
    origin: Point
    """Its lowest corner, world units."""


class DecimationRecord(msgspec.Struct, frozen=True):
    """What fewer triangles cost."""

    triangles_before: Count
    typical_error: Amount
    """World units; 90% of the surface moved by less."""
    largest_error: Amount
    """World units."""


class MeshRecord(msgspec.Struct, frozen=True):
    """The mesh, and what was repaired in it."""

    vertices: Count
    triangles: Count
    support: list[Count]
    """How many vertices so many views support: none, one, two, ..."""
    supported_share: Share
    """Of the surface that was measured."""
    predicted_accuracy: Amount | None = None
    """World units; 90% of the measured surface is predicted to lie nearer to the truth. None: of voxels."""
    small_components: Count = 0
    non_manifold_edges: Count = 0
    non_manifold_vertices: Count = 0
    inward_pieces: Count = 0
    decimation: DecimationRecord | None = None


class ReprojectionRecord(msgspec.Struct, frozen=True):
    """Photographs against renderings of the mesh."""

    pixels: Count
    median: Amount | None
    """Grey levels, as the next two; None: nothing was compared."""
    mean: Amount | None
    rms: Amount | None
    overlap: Share | None
    """Intersection over union with the silhouettes; None: there are none."""


class QualityRecord(msgspec.Struct, frozen=True):
    """What photographs and shape say of the mesh."""

    reprojection: ReprojectionRecord
    views: dict[str, ReprojectionRecord]
    shape: dict[str, float | None]


class EvaluationRecord(msgspec.Struct, frozen=True):
    """Distances to a ground truth."""

    accuracy_percent: Percent
    accuracy_mm: Amount
    completeness_threshold_mm: Amount
    completeness_percent: Percent
    median_mm: Amount
    mean_reconstruction_to_ground_truth_mm: Amount
    mean_ground_truth_to_reconstruction_mm: Amount
    reconstruction_samples: Count
    ground_truth_samples: Count
    samples_left_out: Count


class RunRecord(msgspec.Struct, frozen=True):
    """Every parameter, version, timing and figure of a run."""

    scene: SceneRecord
    format: Annotated[int, Meta(ge=1)] = FORMAT
    recon3d: str | UnsetType = UNSET
    """Version of the program."""
    versions: dict[str, str] = {}
    """Of what it computed with."""
    settings: dict[str, Any] | None = None
    """As ``Settings.record`` makes them."""
    volume: VolumeRecord | None = None
    voxels: dict[str, Count] = {}
    """How many of each label."""
    mesh: MeshRecord | None = None
    timings_s: dict[str, Amount] = {}
    quality: QualityRecord | None = None
    evaluation: EvaluationRecord | None = None
    supported_evaluation: EvaluationRecord | None = None


class _Versioned(msgspec.Struct, frozen=True):
    format: Annotated[int, Meta(ge=1)] = 1


def read_run_record(path: Path) -> RunRecord:
    """The record of a run, every field of it in its range.

    Raises
    ------
    DataError : the file cannot be read, is no record of a run, or of a newer version; it says where and what.
    """
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise DataError(f"{path}: expected the record of a run, got a file of more than {_MOST_BYTES >> 20} MB")
        content = path.read_bytes()
        version = msgspec.json.decode(content, type=_Versioned).format
        if version > FORMAT:
            raise DataError(
                f"{path}: the record's format is {version}, of a newer recon3d; this one knows those up to {FORMAT}"
            )
        return msgspec.json.decode(content, type=RunRecord)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: expected the record of a run, got something else ({error})") from None
    except OSError as error:
        raise DataError(f"{path}: the record cannot be read ({error.strerror})") from None
