"""The demo: the shipped weights are exported, checked, run and evaluated on a synthetic scene."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

from ..runtime import Pipeline
from ..runtime.bundle.manifest import read_manifest, sha256
from ..runtime.extras import needs_extra
from ..runtime.progress import Progress, no_progress
from .inference import RunSummary, run_stream
from .input_warnings import InputWarnings
from .notify import Notify, ignore
from .pictures import PictureOptions
from .run_folder import RunSettings, check_run_folder, open_run_folder, read_run_settings
from .source_check import check_source
from .sources import open_source

PRESET = "nano"
SOURCE = "synthetic:7:16"  # no training uses this seed
FRAME_SHOWN = 12  # the command prints the path of this frame's picture


@dataclass(frozen=True)
class Demo:
    """A demo in the folder `out`.

    weights: the shipped weights.
    exported: whether an earlier demo has exported the bundle, so that only its parity is checked again.
    """

    out: Path
    weights: Path
    exported: bool

    @property
    def bundle(self) -> Path:
        """The folder of the demo's bundle."""
        return self.out / "bundle"

    @property
    def picture(self) -> Path:
        """One of the rendered pictures."""
        return self.out / "pictures" / f"{FRAME_SHOWN:06d}.png"


def prepare_demo(out: str | Path, notify: Notify = ignore) -> Demo:
    """Check the folder of a demo. Removes the bundle of an earlier demo if it was made from other weights.

    Raises OutputError if the folder holds the results of another run, and MissingExtraError without PyTorch or weights.
    """
    with needs_extra("export"):
        from ..weights import shipped_weights

    out = Path(out)
    is_ours = read_run_settings(out) == _settings()
    check_run_folder(out, overwrite=is_ours, resume=False)
    bundle, weights = out / "bundle", shipped_weights(PRESET)
    if is_ours and bundle.exists() and read_manifest(bundle).weights.file_sha256 != sha256(weights):
        notify(f"{bundle}: an earlier demo made it from other weights; it is exported again")
        shutil.rmtree(bundle)
    return Demo(out, weights, exported=bundle.exists())


def run_demo(demo: Demo, progress: Progress = no_progress, notify: Notify = ignore) -> RunSummary:
    """Run the demo's bundle on the demo's synthetic scene, with pictures, video and maps."""
    pipeline, source, warnings = Pipeline.load(demo.bundle), open_source(SOURCE), InputWarnings(notify)
    check_source(source, pipeline.manifest, warnings)
    stream, pictures = pipeline.stream(maps=True), PictureOptions(draw=True, video=True)
    with open_run_folder(demo.out, _settings(), overwrite=True, notify=notify) as folder:
        summary = run_stream(pipeline, stream, source, folder, pictures=pictures, progress=progress, warnings=warnings)
    return replace(summary, out=demo.out)


def _settings() -> RunSettings:
    return {"demo": SOURCE}
