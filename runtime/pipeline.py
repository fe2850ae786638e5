"""A bundle at work: shared sessions, and a stream a vehicle that keeps the temporal memory right."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .bundle.consistency import check_consistency
from .bundle.manifest import MANIFEST_NAME, Manifest, check_files, read_manifest, slot_name
from .detections import Detections, HistoryReport, select, sigmoid
from .errors import ArtifactError, UsageError
from .frame import Frame
from .history import History, PastFrame
from .lost_cameras import MissingCameraPolicy, check_missing_camera_policy, skip_reason
from .preprocessing import NetworkInputs, prepare_inputs
from .session import Session, Tensors, open_sessions, tensors
from .validation import check_frame

Calibration = tuple[NDArray[np.float32], NDArray[np.bool_]]  # image_T_ego (N, 3, 4) and camera_valid (N)


class Pipeline:
    """The sessions of a bundle. They hold no state: every vehicle has its own `stream()`."""

    def __init__(self, manifest: Manifest, sessions: Mapping[str, Session]) -> None:
        self.manifest = manifest
        self.sessions = sessions
        self.empty_memory = _empty_memory(manifest)

    @classmethod
    def load(cls, bundle: str | Path, threads: int | None = None, require_parity: bool = True) -> "Pipeline":
        """Check a bundle folder as a whole and load it.

        threads: of the pool that all graphs of the process share; None for the cores this process may use.
        proven: refuse a bundle that does not carry a passed parity report.
        Raises ArtifactError, naming the file and the field.
        """
        bundle = Path(bundle)
        manifest = read_manifest(bundle)
        if require_parity and not (manifest.parity and manifest.parity.passed):
            raise ArtifactError(
                f"{bundle / MANIFEST_NAME}: field parity: expected a passed proof; got "
                f"{'a failed one' if manifest.parity else 'none'}. Export again with duospacenet export."
            )
        check_files(bundle, manifest)
        sessions = open_sessions(bundle, manifest, threads)
        check_consistency(bundle, manifest)
        return cls(manifest, sessions)

    def stream(self, maps: bool = False, on_missing: MissingCameraPolicy = "blank") -> "Stream":
        """A new stream with an empty history.

        maps: ask for map masks too. on_missing: what to do with a frame of lost cameras, "blank" them, "skip" the
        frame or raise an "error"; a frame without any picture is skipped or an error.
        Raises UsageError where maps are asked of a bundle that draws none.
        """
        if maps and "segmenter" not in self.sessions:
            raise UsageError(f"maps: expected a bundle with map classes; preset {self.manifest.preset} draws no map.")
        return Stream(self, maps, check_missing_camera_policy(on_missing))


class Stream:
    """One vehicle's frames, in time order. Not to be stepped from two threads at once."""

    def __init__(self, pipeline: Pipeline, maps: bool = False, on_missing: MissingCameraPolicy = "blank") -> None:
        self._pipeline = pipeline
        self._maps = maps
        self._on_missing = on_missing
        self._history = History(pipeline.manifest)
        self._calibration: Calibration | None = None
        self._tables: Tensors = {}

    def reset(self) -> None:
        """Drop the history: the next frame is answered as a cold start would."""
        self._history = History(self._pipeline.manifest)

    def step(self, frame: Frame) -> Detections:
        """Detect the objects of `frame`. One that is skipped, for lost cameras, leaves the history as it was.

        Raises InputError for a frame that cannot be right, or is not later than the one before in its scene; the
        stream is then as if the frame had never come.
        """
        manifest, clock = self._pipeline.manifest, Stopwatch()
        with clock("preprocess"):
            check_frame(frame, manifest.num_cameras)
            reset_reason = self._history.reset_reason(frame)
            if skipped := skip_reason(frame, self._on_missing):
                return Detections.of_skipped_frame(frame, skipped)
            history = History(manifest) if reset_reason else self._history
            inputs = prepare_inputs(frame, manifest.preprocessing, manifest.num_cameras)
        features = self._encode(inputs, clock)
        now = PastFrame.of(frame, inputs, {name: features[name] for name in manifest.memory})
        with clock("decoder"):
            window, num_frames = history.window(now, self._pipeline.empty_memory)
            outputs = self._pipeline.sessions["decoder"].run(window)
        maps, dropped_map_cells = self._segment(features, clock) if self._maps else ({}, 0)
        with clock("postprocess"):
            queries, labels, scores, dropped = select(outputs["class_logits"].numpy(), outputs["boxes"].numpy())
        detections = Detections(
            boxes=outputs["boxes"].numpy()[queries],
            scores=scores,
            classes=tuple(manifest.classes[label] for label in labels),
            queries=queries,
            history=HistoryReport(num_frames, reset_reason),
            maps=maps,
            dropped_queries=dropped,
            dropped_map_cells=dropped_map_cells,
            timings_s=clock.seconds,
            scene=frame.scene,
            token=frame.token,
            timestamp_s=now.timestamp_s,
        )
        self._history = history.after(now)
        return detections

    def _encode(self, inputs: NetworkInputs, clock: "Stopwatch") -> Tensors:
        """Images and calibration to the PV and BEV features, and what they leave in memory."""
        sessions = self._pipeline.sessions
        with clock("backbone"):
            features = sessions["backbone"].run(tensors(images=inputs.images))
        if "lifter" not in sessions:
            return features
        with clock("projector"):
            tables = self._lifting_tables(inputs)
        with clock("lifter"):
            return features | sessions["lifter"].run(features | tables)

    def _lifting_tables(self, inputs: NetworkInputs) -> Tensors:
        """The lifter's tables, computed anew only when a projection or the set of live cameras has changed."""
        calibration = inputs.image_T_ego, inputs.camera_valid
        if self._calibration is None or not all(map(np.array_equal, calibration, self._calibration)):
            bound = tensors(image_T_ego=inputs.image_T_ego, camera_valid=inputs.camera_valid)
            self._tables = self._pipeline.sessions["projector"].run(bound)
            self._calibration = calibration
        return self._tables

    def _segment(self, features: Tensors, clock: "Stopwatch") -> tuple[dict[str, NDArray[np.float32]], int]:
        """Probabilities (X, Y) by map class, and how many cells were not finite and are 0 instead."""
        with clock("segmenter"):
            masks = self._pipeline.sessions["segmenter"].run(features)
            logits = {name: mask.numpy()[0, 0] for name, mask in masks.items()}
            broken = sum(int((~np.isfinite(mask)).sum()) for mask in logits.values())
            return {name: np.where(np.isfinite(mask), sigmoid(mask), 0) for name, mask in logits.items()}, broken


class Stopwatch:
    """Seconds by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - start


def _empty_memory(manifest: Manifest) -> Tensors:
    """What stands in the slots of frames that have not been: zeros, written once for all streams."""
    specs = {tensor.name: tensor for tensor in manifest.graphs["decoder"].inputs}
    shapes = {name: specs[slot_name(0, name)].shape for name in manifest.memory}
    return tensors(**{name: np.zeros(shape, np.float32) for name, shape in shapes.items()})
