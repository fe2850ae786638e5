"""Runs the golden example of a bundle, and compares the tensors and the results of its frames. Needs no PyTorch."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..data.results import FrameResult, frame_result, read_results
from ..data.scene_folder import SceneFolder
from ..runtime import Frame, Pipeline
from ..runtime.bundle.golden_files import read_expected_values
from ..runtime.bundle.golden_record import ExpectedValues, GoldenRecord
from ..runtime.bundle.manifest import MANIFEST_NAME
from ..runtime.errors import ArtifactError, InputError, OutputError
from ..runtime.golden_comparison import run_golden_frames
from ..runtime.progress import Progress, no_progress
from .golden_results import first_result_difference
from .inspection import inspect_bundle


@dataclass(frozen=True)
class GoldenCheck:
    """The result of running a golden example.

    engine: name, version and precision of the library that ran the graphs.
    frames: number of frames. tensors, values: numbers of compared tensors and values; results are not counted.
    difference: the first difference as one line, or None.
    """

    engine: dict[str, str]
    frames: int
    tensors: int
    values: int
    difference: str | None

    @property
    def passed(self) -> bool:
        """Whether everything is equal within the tolerances."""
        return self.difference is None

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return {"passed": self.passed, **vars(self)}


def check_golden_example(
    bundle: str | Path, engine: str = "onnxruntime", progress: Progress = no_progress
) -> GoldenCheck:
    """Check the files of a bundle, run its golden example from a cold start, and compare.

    Raises ArtifactError for a damaged bundle, and for one without a golden example.
    """
    bundle = Path(bundle)
    manifest = inspect_bundle(bundle)
    if manifest.golden is None:
        raise ArtifactError(
            f"{bundle / MANIFEST_NAME}: field golden: expected a golden example, as in every export since schema 5; "
            "got none. Export again."
        )
    expected = read_expected_values(bundle, manifest.golden)
    frames, results = _read_scene(bundle, manifest.golden, expected)
    pipeline = Pipeline.load(bundle, engine=engine)
    tensors = [tensor for frame in expected.frames for tensor in frame.tensors.values()]
    num_values = sum(value is not None for tensor in tensors for value in tensor.values)
    difference = _first_difference(pipeline, frames, expected, results, progress)
    return GoldenCheck(dict(pipeline.engine), len(frames), len(tensors), num_values, difference)


def _read_scene(bundle: Path, record: GoldenRecord, expected: ExpectedValues) -> tuple[list[Frame], list[FrameResult]]:
    """The frames and the expected result lines. Raises ArtifactError if they do not belong together."""
    try:
        frames = list(SceneFolder(bundle / record.scene))
        results = list(read_results(bundle / record.results))
    except (InputError, OutputError) as error:
        raise ArtifactError(f"the golden example of the bundle: {error}") from error
    tokens = [[frame.token for frame in frames], [frame.token for frame in expected.frames]]
    if not tokens[0] == tokens[1] == [result["token"] for result in results]:
        raise ArtifactError(
            f"{bundle / record.expected}: expected the frames of {record.scene} and {record.results}; got others. "
            "Export again."
        )
    return frames, results


def _first_difference(
    pipeline: Pipeline,
    frames: Sequence[Frame],
    expected: ExpectedValues,
    results: Sequence[FrameResult],
    progress: Progress,
) -> str | None:
    runs = run_golden_frames(pipeline, progress(frames, "golden example"), expected.frames)
    for number, (run, frame, result) in enumerate(zip(runs, frames, results, strict=True)):
        if run.difference is not None:
            return str(run.difference)
        found = frame_result(frame, run.detections, {})
        if difference := first_result_difference(result, found, expected.tolerance):
            return f"frame {number} ({frame.token}), results.jsonl: {difference}"
    return None
