"""The heatmaps of a run: `heatmaps/000000.png`, one per processed frame."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from ..data.images import write_png
from ..drawing.feature_panels import FeatureMaps
from ..drawing.heat import HIGH_PERCENT, LOW_PERCENT
from ..drawing.heatmap_picture import DetectedObject, draw_heatmaps
from ..runtime import Detections, Frame, Pipeline
from ..runtime.bundle.manifest import Manifest
from ..runtime.printable import printable
from ..runtime.session import Session, Tensors
from .processed_frame import ProcessedFrame

SUBFOLDER = "heatmaps"
BEV_NAME = "bev"


class RecordedSession:
    """A session that keeps the outputs of its last run, without a copy."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.outputs: Tensors = {}

    @property
    def precision(self) -> str:
        """The number format of the session."""
        return self._session.precision

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        """Run the graph as `Session.run` does."""
        self.outputs = self._session.run(tensors)
        return self.outputs


class HeatmapRecorder:
    """Records the features of a pipeline's frames, for one stream.

    pipeline: with the same results as the recorded one. Open the stream on it.
    pv_name, bev_name: the tensors of the heatmaps; None if the bundle has none.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        graphs = [name for name in ("backbone", "lifter") if name in pipeline.sessions]
        self._recorded = {name: RecordedSession(pipeline.sessions[name]) for name in graphs}
        self.pipeline = pipeline.with_sessions({**pipeline.sessions, **self._recorded})
        self.pv_name = pv_tensor(pipeline.manifest)
        self.bev_name = BEV_NAME if "lifter" in pipeline.sessions else None

    def features(self, frame: Frame) -> FeatureMaps:
        """The features of the frame that the stream has processed last."""
        outputs = {name: value for each in self._recorded.values() for name, value in each.outputs.items()}
        bev = None if self.bev_name is None else outputs[self.bev_name].numpy()[0]
        if self.pv_name is None:
            return FeatureMaps(None, bev)
        levels = outputs[self.pv_name].numpy()
        images = [frame.images[name] for name in frame.cameras]  # the network's cameras have the order of the frame's
        pairs = zip(frame.cameras, images, levels, strict=False)
        return FeatureMaps({name: level for name, image, level in pairs if image is not None}, bev)


class HeatmapWriter:
    """Draws the heatmaps of each frame, and writes them. A skipped frame has no features, so it has no picture."""

    def __init__(self, out: Path, recorder: HeatmapRecorder, min_score: float, range_m: float) -> None:
        """min_score: of the objects that may have patches. range_m: of the BEV features from the ego."""
        self._out, self._recorder, self._min_score, self._range_m = out, recorder, min_score, range_m
        self._preprocessing = recorder.pipeline.manifest.preprocessing
        self._notes = _notes(recorder)

    def add(self, processed: ProcessedFrame) -> None:
        """Draw the frame that the stream has just processed, and write it."""
        frame, detections = processed.frame, processed.detections
        if detections.skipped is None:
            features, objects = self._recorder.features(frame), _objects(detections, self._min_score)
            notes = [_caption(frame), *self._notes]
            picture = draw_heatmaps(frame, features, objects, self._preprocessing, self._range_m, notes)
            write_png(self._out / SUBFOLDER / f"{processed.index:06d}.png", picture)


def pv_tensor(manifest: Manifest) -> str | None:
    """The backbone's output that PV heatmaps show: of the finest level, and the first decoder layer.

    These are the values from which PV attention samples. A model without PV attention has only the levels that are
    lifted to BEV, reduced to fewer channels.
    """
    outputs = [tensor.name for tensor in manifest.graphs["backbone"].outputs]
    cached = [name for name in outputs if name in manifest.memory]
    return next(iter(cached or outputs), None)


def _objects(detections: Detections, min_score: float) -> list[DetectedObject]:
    rows = np.flatnonzero(detections.scores >= min_score)
    return [_object(detections, row) for row in rows]


def _object(detections: Detections, row: np.int64) -> DetectedObject:
    box: NDArray[np.float64] = detections.boxes[row].astype(np.float64)
    return DetectedObject(box, f"{printable(detections.classes[row])} {detections.scores[row]:.2f}")


def _caption(frame: Frame) -> str:
    return ", ".join(printable(part) for part in (frame.scene, frame.token) if part)


def _notes(recorder: HeatmapRecorder) -> list[str]:
    """What the colours mean."""
    names = " and ".join(name for name in (recorder.pv_name, recorder.bev_name) if name)
    return [
        f"heat: length of the difference between the features of a cell and their mean over the frame; tensors {names}",
        f"black: at most percentile {LOW_PERCENT:g} of the frame; brightest: at least percentile {HIGH_PERCENT:g}",
    ]
