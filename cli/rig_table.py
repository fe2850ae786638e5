"""The report on a rig as a table and text."""

from typing import TYPE_CHECKING, Any

from rich import box
from rich.markup import escape
from rich.table import Table

from ..rig import Finding, Verdict
from ..rig.diagnoses import group_findings
from ..rig.formatting import describe_sectors
from .console import print_result

if TYPE_CHECKING:
    from ..jobs.rig_check import RigCheck

_STYLES = {Verdict.OK: "green", Verdict.NOT_JUDGED: "cyan", Verdict.SUSPECT: "yellow", Verdict.BROKEN: "red"}


def print_rig(check: "RigCheck") -> None:
    """Print the cameras, the findings, the coverage and the verdict."""
    examination, rig, drive = check.examination, check.report["rig"], check.report["drive"]
    print_result(_camera_table(check.report))
    for diagnosis in group_findings({name: view.findings for name, view in examination.views.items()}):
        _print_finding(diagnosis.describe_cameras(len(examination.views)), diagnosis.finding)
    for finding in examination.motion_findings:
        _print_finding("drive", finding)
    for finding in examination.box_findings:
        _print_finding("ground truth", finding)
    for check_not_made in examination.not_judged:
        print_result(f"not judged: {escape(str(check_not_made))}", soft_wrap=True)
    if rig["counted"]:
        shares = ", ".join(f"{number}: {share:.1%}" for number, share in rig["voxels_seen_by"].items())
        print_result(f"voxels by number of cameras that cover them, of {len(rig['counted'])}: {shares}", soft_wrap=True)
        print_result(describe_sectors(examination.blind_sectors), soft_wrap=True)
    pace = "" if drive["median_step_s"] is None else f", {drive['median_step_s']:.3g} s apart"
    print_result(f"{drive['frames']} frames{pace}; pictures of {len(check.report['looked_at'])} frames checked")
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
    for column in ("view", "azimuth", "up", "roll", "z", "voxels", "alone"):
        table.add_column(column, justify="right", no_wrap=True)
    for name, camera in report["cameras"].items():
        angles, coverage = camera["field_of_view_deg"], camera["coverage"] or {}
        table.add_row(
            escape(name),
            _styled(camera["verdict"]),
            f"{_number(angles['horizontal'], 0)}x{_number(angles['vertical'], 0)}",
            *(_number(camera[field], 1) for field in ("azimuth_deg", "elevation_deg", "roll_deg")),
            _number(camera["position_m"][2], 2),
            *(_share(coverage.get(field)) for field in ("voxels_seen", "voxels_seen_alone")),
        )
    return table


def _print_finding(subject: str, finding: Finding) -> None:
    frames = f"frame {finding.frame}" + (f" and {finding.num_frames - 1} more" if finding.num_frames > 1 else "")
    text = f"{escape(subject)}, {frames}: {escape(str(finding))}"
    print_result(f"{_styled(finding.verdict)} {text}", soft_wrap=True)


def _styled(verdict: Verdict) -> str:
    return f"[{_STYLES[verdict]}]{verdict}[/{_STYLES[verdict]}]"


def _number(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{round(value, decimals) + 0.0:.{decimals}f}"  # + 0.0 turns -0.0 into 0.0


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"
