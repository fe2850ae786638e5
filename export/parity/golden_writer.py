"""Writes a golden file: inputs and outputs of eager mode, for parity on machines without PyTorch.

The tolerances are those of the parity check. The file has only some of its cases, because all of them would take
gigabytes:

- The whole stress sequence as a stream, with the results of every frame.
- Each graph on three frames: the first frame with a full window, which has lost cameras in every slot; the last one,
  with two calibrations; and the last frame of the sequence, with a cold start and cameras close to the ground.
- Each graph on two random inputs: one of nearby points, and one of the whole legal domain.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile, ZipInfo

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...model import DuoSpaceNet
from ...runtime import Frame
from ...runtime.files import atomic_path
from ...runtime.parity.golden_file import ABOUT, about_text
from ...runtime.parity.golden_file_record import CameraRecord, CaseRecord, GoldenFileRecord, StreamFrameRecord
from ...runtime.progress import Progress, no_progress
from ...weights.input_contract import temporal_window
from ...weights.provenance import hash_weights
from ..graphs import Graph, graphs_to_export
from .comparison import arrays, update_scales
from .expected_windows import expected_windows
from .random_inputs import RandomInputs
from .reference import EagerReference, GraphRun
from .stress_sequence import stress_sequence

SEEDS = (0, 2)  # every third seed uses the whole legal domain
_ZIP_TIME = (1980, 1, 1, 0, 0, 0)  # of the archive's members, so that two files are equal


@torch.no_grad()
def write_golden_file(path: Path, model: DuoSpaceNet, progress: Progress = no_progress) -> None:
    """Write the golden file of a model. Raises OutputError if it cannot be written.

    progress: shows the progress over the frames and over the random inputs.
    """
    with atomic_path(path) as temporary, ZipFile(temporary, "w", ZIP_STORED) as archive:
        _GoldenWriter(archive, model).write(progress)


class _GoldenWriter:
    def __init__(self, archive: ZipFile, model: DuoSpaceNet) -> None:
        self._archive, self._reference = archive, EagerReference(model)
        self._exported = graphs_to_export(model)
        self._names: dict[str, str] = {}  # by hash of an array, its name in the archive
        self._cases: list[CaseRecord] = []
        self._scales: dict[str, float] = {}

    def write(self, progress: Progress) -> None:
        config = self._reference.config
        frames = stress_sequence(config)
        windows = expected_windows(frames, temporal_window(config))
        chosen, stream = _chosen_frames(windows), []
        for index, window in enumerate(progress(windows, "golden file, stress sequence")):
            runs = self._reference.step(frames, window) if window else {}
            for run in runs.values():
                update_scales(self._scales, run)
            if index in chosen:
                for graph in self._exported:
                    self._add_case(graph, runs[graph.name], frame=index)
            stream.append(self._stream_frame(index, frames[index], len(window), runs))
        for graph in progress(self._exported, "golden file, random inputs"):
            for seed in SEEDS:
                inputs = RandomInputs(self._reference.model, self._scales, seed).sample(graph)
                self._add_case(graph, self._reference.run(graph.name, inputs), seed=seed)
        about = GoldenFileRecord(
            schema_version=1,
            preset=config.preset,
            weights_sha256=hash_weights(self._reference.model),
            classes=config.classes,
            cases=tuple(self._cases),
            stream=tuple(stream),
        )
        self._write_array(ABOUT, np.array(about_text(about)))

    def _add_case(self, graph: Graph, run: GraphRun, frame: int | None = None, seed: int | None = None) -> None:
        """Store a run of a graph. The backbone gets as many cameras as in the bundle."""
        inputs, outputs = _first_cameras(run.inputs, graph.inputs), _first_cameras(run.outputs, graph.outputs)
        case = f"{graph.name}/{f'frame-{frame}' if seed is None else f'random-{seed}'}"
        self._cases.append(
            CaseRecord(
                name=case,
                graph=graph.name,
                frame=frame,
                seed=seed,
                inputs={key: self._store(f"{case}/inputs/{key}", value) for key, value in arrays(inputs).items()},
                outputs={key: self._store(f"{case}/outputs/{key}", value) for key, value in arrays(outputs).items()},
                heading=self._heading(case, run),
            )
        )

    def _heading(self, where: str, run: GraphRun | None) -> str | None:
        heading = None if run is None else run.heading_array()
        return None if heading is None else self._store(f"{where}/heading", heading)

    def _stream_frame(self, index: int, frame: Frame, window: int, runs: Mapping[str, GraphRun]) -> StreamFrameRecord:
        results = {
            key: value for name in ("decoder", "segmenter") if name in runs for key, value in runs[name].outputs.items()
        }
        where = f"stream/{index}"
        cameras = {name: self._camera(where, frame, name) for name in frame.cameras}
        return StreamFrameRecord.model_validate(
            {
                "token": frame.token,
                "scene": frame.scene,
                "timestamp_s": float(frame.timestamp_s),
                "global_T_ego": frame.global_T_ego.tolist(),
                "cameras": cameras,
                "window": window,
                "outputs": {key: self._store(f"{where}/{key}", value) for key, value in arrays(results).items()},
                "heading": self._heading(where, runs.get("decoder")),
            }
        )

    def _camera(self, where: str, frame: Frame, name: str) -> CameraRecord:
        camera, image = frame.cameras[name], frame.images[name]
        return CameraRecord.model_validate(
            {
                "width_px": camera.width_px,
                "height_px": camera.height_px,
                "intrinsics_px": camera.intrinsics_px.tolist(),
                "camera_T_ego": camera.camera_T_ego.tolist(),
                "image": None if image is None else self._store(f"{where}/{name}", image),
            }
        )

    def _store(self, name: str, array: NDArray) -> str:
        """Store an array and return its name. An equal array is stored once: cached values occur in several slots."""
        array = np.ascontiguousarray(array)
        key = hashlib.sha256(f"{array.dtype} {array.shape}".encode() + array.tobytes()).hexdigest()
        if key not in self._names:
            self._names[key] = name
            self._write_array(name, array)
        return self._names[key]

    def _write_array(self, name: str, array: NDArray) -> None:
        with self._archive.open(ZipInfo(f"{name}.npy", _ZIP_TIME), "w", force_zip64=True) as member:
            np.lib.format.write_array(member, array, allow_pickle=False)


def _chosen_frames(windows: Sequence[Sequence[int]]) -> set[int]:
    """The frames on which single graphs are stored."""
    largest = max(map(len, windows))
    full = [index for index, window in enumerate(windows) if len(window) == largest]
    return {full[0], full[-1], len(windows) - 1}


def _first_cameras(values: Mapping[str, Tensor], specs: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors, cut to the size of the graph in the bundle along the first axis."""
    return {name: value[: specs[name].shape[0]] if value.ndim else value for name, value in values.items()}
