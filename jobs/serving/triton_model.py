"""The model that Triton's Python backend runs: the frames of many vehicles, each in the stream of its sequence.

Triton's module `triton_python_backend_utils` exists only in the process that runs the model, so `1/model.py` of the
model repository imports it and passes it on.
"""

import json
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...runtime import Pipeline, Stream
from ...runtime.cores import available_cores
from ...runtime.errors import ArtifactError, DuoSpaceNetError, InputError, UsageError
from ...runtime.lost_cameras import check_missing_camera_policy
from ...runtime.printable import printable
from .detection_response import MAPS, response_arrays
from .frame_request import read_frame
from .sequence_streams import SequenceStreams
from .serving_options import ServingOptions
from .serving_tensors import END, START
from .triton_config import read_options

BUNDLE_FOLDER = "bundle"  # in the folder of the model's version


class TritonModel:
    """A loaded bundle, and one stream per sequence that Triton assigns to this process."""

    def __init__(self, utils: Any, arguments: Mapping[str, str]) -> None:
        """Load the bundle.

        utils: the module `triton_python_backend_utils`.
        arguments: what Triton passes to `TritonPythonModel.initialize`: the folder of the model, its version, and its
            configuration as JSON.
        Raises `utils.TritonModelException` with a message for the server's log.
        """
        self._utils = utils
        config = json.loads(arguments["model_config"])
        folder = Path(arguments["model_repository"]) / arguments["model_version"] / BUNDLE_FOLDER
        try:
            _check_arrays(utils)
            self._pipeline, self._sequences = _load(folder, read_options(config))
        except DuoSpaceNetError as error:
            raise utils.TritonModelException(printable(str(error))) from error

    @property
    def num_sequences(self) -> int:
        """The number of streams in memory."""
        return len(self._sequences)

    def execute(self, requests: Sequence[Any]) -> list[Any]:
        """Process requests in their order. Returns one response for each: the outputs that it asks for, or an error.

        A request that is refused changes nothing about its sequence, apart from the start and the end that it carries.
        """
        return [self._respond(request) for request in requests]

    def _respond(self, request: Any) -> Any:
        utils = self._utils
        try:
            return utils.InferenceResponse(self._process(request))
        except DuoSpaceNetError as error:
            is_bad_request = isinstance(error, InputError | UsageError)
            code = utils.TritonError.INVALID_ARG if is_bad_request else utils.TritonError.INTERNAL
            return utils.InferenceResponse(error=utils.TritonError(printable(str(error)), code))
        except Exception as error:
            # A bug, or too little memory. Raised here, it would also take the answers of the other vehicles' frames.
            traceback.print_exc()  # in the server's log
            text = printable(f"internal error: {type(error).__name__}: {error}")
            return utils.InferenceResponse(error=utils.TritonError(text, utils.TritonError.INTERNAL))

    def _process(self, request: Any) -> list[Any]:
        """Return the requested outputs of a frame."""
        inputs = {tensor.name(): tensor.as_numpy() for tensor in request.inputs()}
        requested = set(request.requested_output_names())
        manifest = self._pipeline.manifest
        starts, ends = bool(inputs[START][0]), bool(inputs[END][0])
        with self._sequences.stream_of(request.correlation_id(), starts, ends) as stream:
            detections = stream.step(read_frame(inputs, manifest.num_cameras), maps=MAPS in requested)
        arrays = response_arrays(detections, manifest)
        return [self._utils.Tensor(name, array) for name, array in arrays.items() if name in requested]


def _load(folder: Path, options: ServingOptions) -> tuple[Pipeline, SequenceStreams]:
    """Load the bundle, and prepare the streams. Raises DuoSpaceNetError."""
    share = max(1, available_cores() // max(1, options.instances))
    pipeline = Pipeline.load(folder, share if options.threads is None else options.threads)
    options.check(pipeline.manifest)
    on_missing = check_missing_camera_policy(options.on_missing)

    def open_stream() -> Stream:
        return pipeline.stream(on_missing=on_missing, history_step_s=options.history_step_s)

    return pipeline, SequenceStreams(open_stream, options.sequences_per_instance, options.idle_s)


def _check_arrays(utils: Any) -> None:
    """Check that the arrays of requests have the right elements. Raises ArtifactError.

    With numpy 2, all elements of an array from Triton's Python backend before 24.12 have the value of the first one.
    """
    expected = np.arange(6, dtype=np.float64).reshape(2, 3)
    # A tensor made of another tensor's memory gets its array from the backend, as the tensors of a request do.
    tensor = utils.Tensor("probe", expected)
    found = utils.Tensor.from_dlpack("probe", tensor).as_numpy()
    if not np.array_equal(found, expected):
        raise ArtifactError(
            "Triton's Python backend: expected arrays with the elements of the request; got others with numpy "
            f"{np.__version__}. Use Triton 24.12 or later, or numpy below 2."
        )
