"""One processed frame of a run, as the writers of its files get it."""

from dataclasses import dataclass

from ..data.results import FrameResult
from ..runtime import Detections, Frame


@dataclass(frozen=True)
class ProcessedFrame:
    """A frame, its detections, and its line in the results.

    index: of the frame in the source. The map files that `result` names are written already.
    """

    index: int
    frame: Frame
    detections: Detections
    result: FrameResult
