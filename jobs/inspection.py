"""The inspection of a bundle's files, and of a model's size."""

from pathlib import Path
from typing import TYPE_CHECKING

from ..runtime.bundle.bundle_files import check_files
from ..runtime.bundle.consistency import check_consistency
from ..runtime.bundle.golden_files import check_golden_files
from ..runtime.bundle.manifest import Manifest, read_manifest
from ..runtime.errors import UsageError
from ..runtime.extras import needs_extra

if TYPE_CHECKING:
    from ..model import DuoSpaceNetConfig
    from ..model.complexity import Complexity


def inspect_bundle(bundle: str | Path) -> Manifest:
    """Read a bundle's manifest, and check its files against it. Raises ArtifactError."""
    bundle = Path(bundle)
    manifest = read_manifest(bundle)
    check_files(bundle, manifest)
    check_consistency(bundle, manifest)
    check_golden_files(bundle, manifest)
    return manifest


def measure_complexity(config: "DuoSpaceNetConfig", num_frames: int = 1) -> dict[str, "Complexity"]:
    """The parameters and FLOPs of each part of a model.

    num_frames: number of frames in the temporal window, 1 to the model's window.
    Raises UsageError for more frames than the model's window has.
    """
    if num_frames > config.num_frames:
        raise UsageError(
            f"--frames: expected at most {config.num_frames}, the temporal window of {config.preset}; got {num_frames}."
        )
    with needs_extra("export"):
        from ..model.complexity import complexity_by_part
    return complexity_by_part(config, num_frames)
