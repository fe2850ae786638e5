"""The error of a checkpoint that cannot be used."""

from typing import TYPE_CHECKING

from ..runtime.errors import ArtifactError

if TYPE_CHECKING:
    from .checkpoint_report import CheckpointReport


class CheckpointError(ArtifactError):
    """A checkpoint that cannot be read or does not match the model. The message names the file and the tensor.

    report: the report on every tensor; None if the file cannot be read.
    """

    def __init__(self, message: str, report: "CheckpointReport | None" = None) -> None:
        super().__init__(message)
        self.report = report
