"""The pipeline: one loaded bundle, shared by all vehicles, and one stream per vehicle with its temporal history."""

import copy
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .bundle.consistency import check_consistency
from .bundle.manifest import MANIFEST_NAME, Manifest, read_manifest, slot_name
from .camera_groups import CameraGroups
from .detections import Detections, HistoryReport, select_detections, sigmoid
from .engine import choose_engine, open_sessions
from .errors import ArtifactError, UsageError
from .frame import Frame
from .history import History, PastFrame
from .lost_cameras import MissingCameraPolicy, check_missing_camera_policy, skip_reason
from .preprocessing import NetworkInputs, prepare
from .session import Session, Tensors, to_tensors
from .validation import check_frame
from .window_selection import WindowSelection

ProjectorInputs = tuple[NDArray[np.float32], NDArray[np.bool_]]  # image_T_ego (N, 3, 4) and camera_valid (N,)


class Pipeline:
    """A loaded bundle: the session of each graph, and the manifest that describes them.

    Load it once per process and open one `stream()` per vehicle. A pipeline stores nothing about frames, so its
    streams may run in different threads at the same time.
    """

    def __init__(
        self, manifest: Manifest, sessions: Mapping[str, Session], engine: Mapping[str, str] | None = None
    ) -> None:
        """Most callers want `Pipeline.load`.

        sessions: by graph name. The backbone takes as many cameras as the manifest says.
        engine: name, version and precision of the library that runs the graphs, for reports.
        """
        self.manifest = manifest
        self.sessions = _with_all_cameras(sessions, manifest)
        self.engine = engine or {}
        self.empty_memory = _empty_memory(manifest)

    @classmethod
    def load(
        cls,
        bundle: str | Path,
        threads: int | None = None,
        require_parity: bool = True,
        engine: str = "onnxruntime",
        engine_precision: str = "float32",
    ) -> "Pipeline":
        """Check a bundle folder completely and load it.

        bundle: the folder that `duospacenet export` wrote.
        threads: size of the thread pool that all graphs of this process share; None for the number of available
            cores.
        require_parity: refuse a bundle without a passed parity report. The report shows that its graphs equal the
            PyTorch model.
        engine: the library that runs the graphs, "onnxruntime" or "openvino".
        engine_precision: number format of float operators, "float32", or "default" for the engine's own choice on this
            CPU.

        Raises ArtifactError, naming the file and the field, if the bundle is damaged or does not fit this toolkit.
        Raises UsageError for an unknown engine, or if the process already has a thread pool of another size.
        Raises MissingExtraError if the engine is not installed.
        """
        bundle, chosen_engine = Path(bundle), choose_engine(engine, engine_precision)
        manifest = read_manifest(bundle)
        if require_parity and not (manifest.parity and manifest.parity.passed):
            raise ArtifactError(
                f"{bundle / MANIFEST_NAME}: field parity: expected a passed parity report; got "
                f"{'a failed one' if manifest.parity else 'no report'}. Export again with duospacenet export."
            )
        # Opening the sessions compares the manifest's tensors with the graphs. The consistency check relies on them.
        sessions = open_sessions(bundle, manifest, threads, chosen_engine)
        check_consistency(bundle, manifest)
        return cls(manifest, sessions, chosen_engine.describe(sessions))

    def with_sessions(self, sessions: Mapping[str, Session]) -> "Pipeline":
        """Return a pipeline of the same bundle with other sessions. Their backbone takes the images of all cameras."""
        copied = copy.copy(self)
        copied.sessions = sessions
        return copied

    def stream(
        self, maps: bool = False, on_missing: MissingCameraPolicy = "blank", history_step_s: float | None = None
    ) -> "Stream":
        """Open a stream with an empty history.

        maps: also compute the probabilities of the map classes, for example of the drivable area.
        on_missing: what to do with a frame that has lost cameras: "blank" masks them, "skip" skips the frame,
            "error" raises an InputError. A frame without any image is skipped, or is an error.
        history_step_s: the time between two frames of the temporal window [s]. None uses the newest frames, which is
            right for streams as fast as the training data. For a faster stream, give the manifest's
            `nominal_time_delta_s`: of a stream at 10 Hz, a model that was trained at 2 Hz then gets the frames that
            are about 0.5, 1.0 and 1.5 s old. `WindowSelection` has the exact rule. The stream keeps the cached values
            of about (window frames - 1) * history_step_s seconds in memory.

        Raises UsageError for an unknown policy, for a step that is not between 0.01 s and the manifest's largest time
        between frames, or if maps are requested from a bundle without map classes.
        """
        self.check_maps(maps)
        return Stream(self, maps, check_missing_camera_policy(on_missing), history_step_s)

    def check_maps(self, maps: bool) -> None:
        """Raise UsageError if maps are requested from a bundle without map classes."""
        if maps and "segmenter" not in self.sessions:
            raise UsageError(
                f"maps: expected a bundle with map classes; got preset {self.manifest.preset}, which has none."
            )


class Stream:
    """Processes the frames of one vehicle in time order, and keeps the history: cached features of past frames.

    Call `step` with each new frame. The network uses the new frame together with the cached features.
    The history is reset automatically when it cannot be continued: in a new scene, after a long gap, or after an
    impossible ego motion. `Detections.history` reports it.
    A stream must not be used by two threads at the same time.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        maps: bool = False,
        on_missing: MissingCameraPolicy = "blank",
        history_step_s: float | None = None,
    ) -> None:
        """Most callers want `Pipeline.stream`, which checks the arguments."""
        self._pipeline = pipeline
        self._maps = maps
        self._on_missing = on_missing
        self._history = History(pipeline.manifest, step_s=history_step_s)
        self._projector_inputs: ProjectorInputs | None = None
        self._tables: Tensors = {}

    def reset(self) -> None:
        """Reset the history. The next frame gives the same result as the first frame of a new stream."""
        self._history = self._history.cleared()

    @property
    def selection(self) -> WindowSelection:
        """The rule by which past frames are selected for the temporal window."""
        return self._history.selection

    @property
    def num_cached_frames(self) -> int:
        """The number of past frames whose cached values are in memory."""
        return len(self._history)

    def step(self, frame: Frame, maps: bool | None = None) -> Detections:
        """Detect the objects of one frame, using this frame and the history.

        frame: images of any size, with calibration, ego pose and time stamp. It must be later than the previous frame
            of the same scene. It is not changed.
        maps: also compute the probabilities of the map classes for this frame; None for the stream's own setting. The
            history is the same with and without maps.

        Returns boxes in the ego frame of this frame, highest score first. If the frame is skipped because of lost
        cameras, the result is empty and the history stays as it was.

        Raises InputError for an invalid frame, or for a time stamp that is not later than the previous one. The
        history does not change then.
        Raises UsageError if maps are requested from a bundle without map classes.
        """
        manifest, clock = self._pipeline.manifest, StageTimer()
        with_maps = self._maps if maps is None else maps
        self._pipeline.check_maps(with_maps)
        with clock("preprocess"):
            check_frame(frame, manifest.num_cameras)
            reset_reason = self._history.reset_reason(frame)
            if skipped := skip_reason(frame, self._on_missing):
                return Detections.of_skipped_frame(frame, skipped)
            history = self._history.cleared() if reset_reason else self._history
            inputs = prepare(frame, manifest.preprocessing, manifest.num_cameras)
        features = self._encode(inputs, clock)
        now = PastFrame.of(frame, inputs, {name: features[name] for name in manifest.memory})
        with clock("decoder"):
            window, ages_s = history.decoder_inputs(now, self._pipeline.empty_memory)
            outputs = self._pipeline.sessions["decoder"].run(window)
        masks, dropped_cells = self._segment(features, clock) if with_maps else ({}, 0)
        with clock("postprocess"):
            queries, labels, scores, dropped = select_detections(
                outputs["class_logits"].numpy(), outputs["boxes"].numpy()
            )
        detections = Detections(
            boxes=outputs["boxes"].numpy()[queries],
            scores=scores,
            classes=tuple(manifest.classes[label] for label in labels),
            queries=queries,
            history=HistoryReport(1 + len(ages_s), reset_reason, ages_s),
            maps=masks,
            dropped_queries=dropped,
            dropped_map_cells=dropped_cells,
            timings_s=clock.seconds,
            scene=frame.scene,
            token=frame.token,
            timestamp_s=now.timestamp_s,
        )
        # The history changes only here, so a step that fails or is interrupted leaves the stream unchanged.
        self._history = history.after(now)
        return detections

    def _encode(self, inputs: NetworkInputs, clock: "StageTimer") -> Tensors:
        """Return the outputs of the backbone and the lifter: PV and BEV features, and the values to cache."""
        sessions = self._pipeline.sessions
        with clock("backbone"):
            features = sessions["backbone"].run(to_tensors(images=inputs.images, camera_valid=inputs.camera_valid))
        if "lifter" not in sessions:
            return features
        with clock("projector"):
            tables = self._lifting_tables(inputs)
        with clock("lifter"):
            return features | sessions["lifter"].run(features | tables)

    def _lifting_tables(self, inputs: NetworkInputs) -> Tensors:
        """Return the lifter's sampling tables. The projector runs only if its inputs have changed."""
        projector_inputs = inputs.image_T_ego, inputs.camera_valid
        if self._projector_inputs is None or not all(map(np.array_equal, projector_inputs, self._projector_inputs)):
            image_T_ego, camera_valid = projector_inputs
            tensors = to_tensors(image_T_ego=image_T_ego, camera_valid=camera_valid)
            self._tables = self._pipeline.sessions["projector"].run(tensors)
            self._projector_inputs = projector_inputs
        return self._tables

    def _segment(self, features: Tensors, clock: "StageTimer") -> tuple[dict[str, NDArray[np.float32]], int]:
        """Return probabilities (X, Y) by map class, and the number of cells that were not finite and are now 0."""
        with clock("segmenter"):
            masks = self._pipeline.sessions["segmenter"].run(features)
            logits = {name: mask.numpy()[0, 0] for name, mask in masks.items()}
            dropped_cells = sum(int((~np.isfinite(mask)).sum()) for mask in logits.values())
            return {name: np.where(np.isfinite(mask), sigmoid(mask), 0) for name, mask in logits.items()}, dropped_cells


class StageTimer:
    """Measures the duration of each stage [s]: `with timer("backbone"): ...`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start_s = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - start_s


def _with_all_cameras(sessions: Mapping[str, Session], manifest: Manifest) -> Mapping[str, Session]:
    """Return the sessions, with a backbone that takes the images of all cameras."""
    spec = manifest.graphs["backbone"]
    if spec.inputs[0].shape[0] == manifest.num_cameras or isinstance(sessions["backbone"], CameraGroups):
        return sessions
    return {**sessions, "backbone": CameraGroups(sessions["backbone"], spec, manifest.num_cameras)}


def _empty_memory(manifest: Manifest) -> Tensors:
    """Return zeros for the window slots without a frame, allocated once for all streams."""
    specs = {tensor.name: tensor for tensor in manifest.graphs["decoder"].inputs}
    shapes = {name: specs[slot_name(0, name)].shape for name in manifest.memory}
    return to_tensors(**{name: np.zeros(shape, np.float32) for name, shape in shapes.items()})
