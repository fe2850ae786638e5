"""The check of a rig: its calibration, times and pictures, with a report and pictures in a folder."""

import json
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
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
from .folder_lock import lock_folder
from .notify import Notify, ignore
from .output_folder import check_not_source, check_writable, find_files, make_folders
from .replacement import Replacement
from .sources import open_recording

REPORT_NAME = "rig.json"
MAP_NAME = "coverage.png"
SUBFOLDER = "cameras"


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
    notify: Notify = ignore,
) -> RigCheck:
    """Check a rig, and write `rig.json`, `coverage.png` and one picture per camera to the folder `out`.

    source: a scene folder, `trusted:FOLDER`, `nuscenes:ROOT[@VERSION][/SPLIT]` or `synthetic:SEED[:FRAMES]`.
    bundle: use the perception range and the image crop of this bundle.
    num_frames: how many frames' images to read, evenly spaced over the source.
    overwrite: replace the files of an earlier check, once the new ones are complete.
    notify: gets a warning if the file system of `out` has no locks.
    Raises OutputError if `out` holds other files of these names, or if another process is writing there.
    """
    out = Path(out)
    recording = open_recording(source, progress)
    check_not_source(out, source)
    requirements = RigRequirements() if bundle is None else RigRequirements.from_manifest(read_manifest(Path(bundle)))
    paths = overlay_paths(recording.camera_names())
    with _open_folder(out, overwrite, paths.values(), notify) as folder:
        examination = examine(recording, requirements, num_frames, progress)
        report = rig_report_dict(str(source), examination, paths)
        _write(folder, examination, paths, report, progress)
    return RigCheck(out, examination, report)


@contextmanager
def _open_folder(out: Path, overwrite: bool, pictures: Collection[str], notify: Notify) -> Iterator[Path]:
    """Lock `out` for one check, and give the folder inside it that the check writes to.

    Its files are moved to `out` when the block ends without an exception, and replace those of an earlier check. After
    an exception, the earlier files are unchanged, and the new ones are removed.
    """
    _check_folder(out, overwrite, pictures)
    make_folders(out, [SUBFOLDER])
    check_writable(out / SUBFOLDER)
    with lock_folder(out, notify):
        _check_folder(out, overwrite, pictures)  # again: another check may have written here before the lock
        _replacement(out).complete()
        replacement = _replacement(out, pictures)
        replacement.discard_new()
        make_folders(replacement.new, [SUBFOLDER])
        try:
            yield replacement.new
        except BaseException:
            replacement.discard_new()
            raise
        replacement.replace_earlier()


def _check_folder(out: Path, overwrite: bool, pictures: Collection[str]) -> None:
    """Check that a check may write to `out`. Only the files of a check whose report is there are replaced.

    pictures: paths of the new pictures, relative to `out`.
    """
    check_writable(out)
    replacement = _replacement(out)
    for name in (REPORT_NAME, MAP_NAME, *pictures):
        if name not in replacement.patterns and (out / name).exists():
            raise OutputError(
                f"{out / name}: no {REPORT_NAME} shows that check-rig wrote this file. Choose another --out."
            )
    earlier = find_files(out, replacement.patterns)
    if (earlier or replacement.is_pending) and not overwrite:
        path = earlier[0] if earlier else replacement.finished
        raise OutputError(f"{path}: an earlier check wrote this. Choose another --out, or add --overwrite.")


def _replacement(out: Path, pictures: Collection[str] | None = None) -> Replacement:
    """The replacement of the files of earlier checks, which their reports list, and of the new pictures if given."""
    replacement = Replacement(out, (), prefix=".check-rig")
    reported = map(_pictures_in_report, (out, replacement.finished, replacement.moving))
    known = [each for each in (*reported, pictures) if each is not None]
    names = dict.fromkeys([REPORT_NAME, MAP_NAME, *(name for each in known for name in each)])
    return replace(replacement, patterns=tuple(names) if known else ())


def _pictures_in_report(out: Path) -> list[str] | None:
    """The pictures inside `cameras/` that an earlier report lists; None without such a report."""
    try:
        cameras = parse_strict_json((out / REPORT_NAME).read_bytes())["cameras"].values()
        pictures = [camera["picture"] for camera in cameras]
    except (OSError, ValueError, LookupError, TypeError, AttributeError):  # no report, or a file of another program
        return None
    return [path for path in pictures if isinstance(path, str) and re.fullmatch(r"cameras/[A-Za-z0-9_-]+\.png", path)]


def _write(
    folder: Path, examination: Examination, paths: dict[str, str], report: dict[str, Any], progress: Progress
) -> None:
    for name, path in progress(list(paths.items()), "drawing"):
        write_png(folder / path, draw_camera_overlay(name, examination))
    write_png(folder / MAP_NAME, draw_rig_coverage(examination))
    write_atomically(folder / REPORT_NAME, (json.dumps(report, indent=1, allow_nan=False) + "\n").encode())
