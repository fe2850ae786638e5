"""The PyTorch model of a bundle, for the alternatives that need one."""

from pathlib import Path
from typing import TYPE_CHECKING

from ...runtime.bundle.manifest import Manifest, sha256
from ...runtime.errors import MissingExtraError
from ...runtime.extras import needs_extra
from ..models import build_model, bundle_config, random_init_options, recorded_selection

if TYPE_CHECKING:
    from ...model import DuoSpaceNet


def find_peer_weights(manifest: Manifest, weights: Path | None) -> Path | None:
    """The checkpoint of a bundle's model: `weights`, else the shipped weights if the bundle was made from them."""
    if weights is not None:
        return weights
    with needs_extra("export"):
        from ...weights import shipped_weights
    try:
        shipped = shipped_weights(manifest.preset)
    except (FileNotFoundError, MissingExtraError):
        return None
    return shipped if sha256(shipped) == manifest.weights.file_sha256 else None


def build_peer_model(bundle: Path, manifest: Manifest, weights: Path | None) -> "DuoSpaceNet":
    """Build the bundle's model with a checkpoint, or with random weights, which give the same speed.

    Raises ArtifactError for a checkpoint that does not fit, and MissingExtraError without torch.
    """
    config = bundle_config(bundle, manifest)
    if weights is None:
        return build_model(config, None, True, 0)[0]
    seed, allow_missing = random_init_options(manifest.weights.checkpoint)
    selection = recorded_selection(manifest.weights.checkpoint)
    return build_model(config, weights, False, seed, allow_missing, **selection)[0]
