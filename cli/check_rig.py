"""`duospacenet check-rig`: whether a rig's calibration, times and pictures can be right, in numbers and to look at."""

import json
import re
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.markup import escape
from rich.table import Table

from ..data.images import write_png
from ..jobs.output_folder import check_apart, prepare_folder
from ..jobs.sources import open_recording
from ..rig import Examination, Finding, RigRequirements, Verdict, examine
from ..rig.formatting import describe_sectors
from ..rig.overlays import draw_camera_overlay, draw_rig_coverage, overlay_paths
from ..rig.rig_report import rig_report_dict
from ..runtime.bundle.manifest import read_manifest
from ..runtime.errors import CheckError, OutputError
from ..runtime.files import write_atomically
from .console import print_json, print_result, show_progress

REPORT_NAME = "rig.json"
MAP_NAME = "coverage.png"
STYLES = {Verdict.OK: "green", Verdict.SUSPECT: "yellow", Verdict.BROKEN: "red"}


def check_rig(
    source: Annotated[str, typer.Argument(help="A scene folder, or synthetic:SEED[:FRAMES].")],
    out: Annotated[Path, typer.Option(help="Folder for rig.json, coverage.png and cameras/.")],
    bundle: Annotated[
        Path | None, typer.Option(help="Judge by what this bundle's network sees: its range, and what it cuts off.")
    ] = None,
    frames: Annotated[
        int, typer.Option(help="How many frames' pictures to look at, spread over the source.", min=1)
    ] = 8,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Remove what an earlier run left in --out.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="rig.json on stdout.")] = False,
) -> None:
    """Look for what is wrong with a rig; exit code 1 where a camera, or the drive's times or poses, are broken.

    ok: nothing is wrong. suspect: it cannot be known, look at the pictures. broken: it cannot be right.
    """
    recording = open_recording(source)
    check_apart(out, source)
    requirements = RigRequirements() if bundle is None else RigRequirements.from_manifest(read_manifest(bundle))
    paths = overlay_paths(recording.camera_names())
    _prepare(out, overwrite, list(paths.values()))
    examination = examine(recording, requirements, frames, show_progress)
    report = rig_report_dict(source, examination, paths)
    _write(out, examination, paths, report)
    if as_json:
        print_json(report)
    else:
        _print(report, examination)
        print_result(f"pictures and all numbers in {out}", markup=False, soft_wrap=True)
    if examination.verdict is Verdict.BROKEN:
        raise CheckError(
            f"broken: {', '.join(_broken(examination))}. See {out / REPORT_NAME} and the pictures beside it."
        )


def _prepare(out: Path, overwrite: bool, pictures: list[str]) -> None:
    """Make `out`; what a report there names is an earlier run's, and whatever else is in the way is somebody's."""
    earlier = _pictures_of_report(out)
    ours = [] if earlier is None else [REPORT_NAME, MAP_NAME, *earlier]
    for name in (REPORT_NAME, MAP_NAME, *pictures):
        if name not in ours and (out / name).exists():
            raise OutputError(f"{out / name}: no {REPORT_NAME} says that check-rig wrote it. Choose another --out.")
    prepare_folder(out, overwrite, ours, ["cameras"])


def _write(out: Path, examination: Examination, paths: dict[str, str], report: dict[str, Any]) -> None:
    """The report first: it tells another run which pictures are ours, should this one be killed."""
    write_atomically(out / REPORT_NAME, (json.dumps(report, indent=1, allow_nan=False) + "\n").encode())
    for name, path in show_progress(list(paths.items()), "drawing"):
        write_png(out / path, draw_camera_overlay(name, examination))
    write_png(out / MAP_NAME, draw_rig_coverage(examination))


def _pictures_of_report(out: Path) -> list[str] | None:
    """The pictures that an earlier run's report names, and nothing outside of their folder; None without a report."""
    try:
        cameras = json.loads((out / REPORT_NAME).read_bytes())["cameras"].values()
        pictures = [camera["picture"] for camera in cameras]
    except (OSError, ValueError, LookupError, TypeError, AttributeError):  # no report, or not one of ours
        return None
    return [path for path in pictures if isinstance(path, str) and re.fullmatch(r"cameras/[A-Za-z0-9_-]+\.png", path)]


def _broken(examination: Examination) -> list[str]:
    names = [f"camera {name}" for name, view in examination.views.items() if view.verdict is Verdict.BROKEN]
    return names + (["the drive"] if examination.motion_verdict is Verdict.BROKEN else [])


def _print(report: dict[str, Any], examination: Examination) -> None:
    print_result(_camera_table(report))
    for name, view in examination.views.items():
        _print_findings(f"camera {name}", view.findings)
    _print_findings("drive", examination.motion_findings)
    rig, drive = report["rig"], report["drive"]
    if rig["counted"]:
        shares = ", ".join(f"by {number}: {share:.1%}" for number, share in rig["voxels_seen_by"].items())
        print_result(f"voxels seen, of {len(rig['counted'])} cameras, {shares}", soft_wrap=True)
        print_result(describe_sectors(examination.blind_sectors), soft_wrap=True)
    pace = "" if drive["median_step_s"] is None else f", {drive['median_step_s']:.3g} s apart"
    print_result(f"{drive['frames']} frames{pace}; pictures of {len(report['looked_at'])} of them looked at")
    print_result(f"rig: {_styled(examination.verdict)}")


def _camera_table(report: dict[str, Any]) -> Table:
    table = Table(
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
        caption="angles in degrees, z in metres, shares of the voxels",
    )
    table.add_column("camera", overflow="fold")
    table.add_column("verdict", no_wrap=True)
    for column in ("sees", "azimuth", "up", "roll", "z", "voxels", "alone"):
        table.add_column(column, justify="right", no_wrap=True)
    for name, camera in report["cameras"].items():
        angles, seen = camera["field_of_view_deg"], camera["coverage"] or {}
        table.add_row(
            escape(name),
            _styled(camera["verdict"]),
            f"{_number(angles['horizontal'], 0)}x{_number(angles['vertical'], 0)}",
            *(_number(camera[field], 1) for field in ("azimuth_deg", "elevation_deg", "roll_deg")),
            _number(camera["position_m"][2], 2),
            *(_share(seen.get(field)) for field in ("voxels_seen", "voxels_seen_alone")),
        )
    return table


def _print_findings(what: str, findings: tuple[Finding, ...]) -> None:
    for finding in findings:
        frames = f"frame {finding.frame}" + (f" and {finding.num_frames - 1} more" if finding.num_frames > 1 else "")
        text = f"{escape(what)}, {frames}: {escape(str(finding))}"
        print_result(f"{_styled(finding.verdict)} {text}", soft_wrap=True)


def _styled(verdict: Verdict) -> str:
    return f"[{STYLES[verdict]}]{verdict}[/{STYLES[verdict]}]"


def _number(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{round(value, decimals) + 0.0:.{decimals}f}"  # + 0.0: no minus before a zero


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"
