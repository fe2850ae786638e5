"""The check of a rig: its calibration, times and pictures, with a report and pictures in a folder."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..data.images import write_png
from ..rig import Examination, RigRequirements, Verdict, examine
from ..rig.overlays import draw_camera_overlay, draw_rig_coverage, overlay_paths
from ..rig.rig_report import rig_report_dict
from ..runtime.bundle.manifest import read_manifest
from ..runtime.errors import OutputError
from ..runtime.files import write_atomically
from ..runtime.progress import Progress, no_progress
from ..runtime.strict_json import parse_strict_json
from .output_folder import check_not_source, prepare_folder
from .sources import open_recording

REPORT_NAME = "rig.json"
MAP_NAME = "coverage.png"


@dataclass(frozen=True)
class RigCheck:
    """The result of a check. report: the content of `rig.json`."""

    out: Path
    examination: Examination
    report: dict[str, Any]

    @property
    def broken(self) -> list[str]:
        """The parts with the verdict broken: names of cameras, "the drive" and "the ground truth"."""
        return self._parts(Verdict.BROKEN)

    @property
    def suspect(self) -> list[str]:
        """The parts with the verdict suspect."""
        return self._parts(Verdict.SUSPECT)

    def _parts(self, verdict: Verdict) -> list[str]:
        examination = self.examination
        parts = {f"camera {name}": view.verdict for name, view in examination.views.items()}
        parts |= {"the drive": examination.motion_verdict, "the ground truth": examination.box_verdict}
        return [part for part in parts if parts[part] is verdict]


def check_rig(
    source: str | Path,
    out: str | Path,
    *,
    bundle: str | Path | None = None,
    num_frames: int = 8,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> RigCheck:
    """Check a rig, and write `rig.json`, `coverage.png` and one picture per camera to the folder `out`.

    source: a scene folder, or `synthetic:SEED[:FRAMES]`.
    bundle: use the perception range and the image crop of this bundle.
    num_frames: how many frames' images to read, evenly spaced over the source.
    overwrite: replace the files of an earlier check.
    Raises OutputError if `out` holds other files of these names.
    """
    out = Path(out)
    recording = open_recording(source)
    check_not_source(out, source)
    requirements = RigRequirements() if bundle is None else RigRequirements.from_manifest(read_manifest(Path(bundle)))
    paths = overlay_paths(recording.camera_names())
    _prepare(out, overwrite, list(paths.values()))
    examination = examine(recording, requirements, num_frames, progress)
    report = rig_report_dict(str(source), examination, paths)
    _write(out, examination, paths, report, progress)
    return RigCheck(out, examination, report)


def _prepare(out: Path, overwrite: bool, pictures: Sequence[str]) -> None:
    """Create `out`. Only files that an earlier report lists are removed; other files of these names are refused."""
    earlier = _pictures_in_report(out)
    replaceable = [] if earlier is None else [REPORT_NAME, MAP_NAME, *earlier]
    for name in (REPORT_NAME, MAP_NAME, *pictures):
        if name not in replaceable and (out / name).exists():
            raise OutputError(
                f"{out / name}: no {REPORT_NAME} shows that check-rig wrote this file. Choose another --out."
            )
    prepare_folder(out, overwrite, replaceable, ["cameras"])


def _pictures_in_report(out: Path) -> list[str] | None:
    """The pictures inside `cameras/` that an earlier report lists; None without such a report."""
    try:
        cameras = parse_strict_json((out / REPORT_NAME).read_bytes())["cameras"].values()
        pictures = [camera["picture"] for camera in cameras]
    except (OSError, ValueError, LookupError, TypeError, AttributeError):  # no report, or a file of another program
        return None
    return [path for path in pictures if isinstance(path, str) and re.fullmatch(r"cameras/[A-Za-z0-9_-]+\.png", path)]


def _write(
    out: Path, examination: Examination, paths: dict[str, str], report: dict[str, Any], progress: Progress
) -> None:
    # The report comes first: if this process is killed, the next check finds in it which pictures it may replace.
    write_atomically(out / REPORT_NAME, (json.dumps(report, indent=1, allow_nan=False) + "\n").encode())
    for name, path in progress(list(paths.items()), "drawing"):
        write_png(out / path, draw_camera_overlay(name, examination))
    write_png(out / MAP_NAME, draw_rig_coverage(examination))
