"""Plots of an evaluation, in a new folder."""

from pathlib import Path
from typing import TYPE_CHECKING

from ..runtime.errors import OutputError
from ..runtime.extras import needs_extra

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..evaluation import EvaluationReport
    from .lost_camera_scores import LostCameraScore


def check_plots(folder: Path) -> None:
    """Check that plots can be written to the new folder, before a long evaluation.

    Raises MissingExtraError, OutputError.
    """
    with needs_extra("viz"):
        from ..evaluation.plots import check_new_folder
    check_new_folder(folder)
    if not folder.absolute().parent.is_dir():
        raise OutputError(
            f"--plots: expected a new folder inside an existing one; got {folder}. Make its parent first."
        )


def write_plots(folder: Path, report: "EvaluationReport", lost_cameras: "Sequence[LostCameraScore]" = ()) -> None:
    """Write `precision.png` and `errors.png` to a new folder, and `lost_cameras.png` if there are such scores.

    Raises MissingExtraError, OutputError.
    """
    with needs_extra("viz"):
        from ..evaluation import plots
    curves = {"NDS": [each.nds for each in lost_cameras], "mAP": [each.mean_ap for each in lost_cameras]}
    plots.write_plots(folder, report, curves if lost_cameras else None)
