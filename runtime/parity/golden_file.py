"""A golden file: inputs and outputs of eager PyTorch that an export wrote, for machines without PyTorch."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ..bundle.manifest import GraphSpec, Manifest, TensorSpec
from ..errors import ArtifactError
from ..frame import Camera, Frame
from ..json_record import check_record, parse_json
from .golden_file_record import CaseRecord, GoldenFileRecord, StreamFrameRecord
from .npz_archive import NpzArchive

ABOUT = "about"


class StreamFrame(NamedTuple):
    """A frame of the stress sequence.

    window: number of frames in its window.
    outputs: of eager PyTorch, by name.
    heading: the lengths (Q) of the vectors (sin θ, cos θ) of the boxes; None if the frame is skipped.
    """

    frame: Frame
    window: int
    outputs: dict[str, NDArray]
    heading: NDArray | None


class GoldenFile:
    """An open golden file. The arrays of a case or a frame are read when they are requested."""

    def __init__(self, path: Path) -> None:
        """Raises ArtifactError, naming the file, if it is damaged or no golden file."""
        self.path = path
        self._archive = NpzArchive(path, ArtifactError)
        try:
            # A lone surrogate becomes bytes that are not UTF-8, which the parser refuses.
            content = self._archive.read_text(ABOUT).encode(errors="surrogatepass")
            self.about = check_record(path, parse_json(path, content, ArtifactError), GoldenFileRecord, ArtifactError)
        except ArtifactError:
            self._archive.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._archive.close()

    @property
    def cases(self) -> tuple[CaseRecord, ...]:
        """The cases of single graphs."""
        return self.about.cases

    def sha256(self) -> str:
        """Return the hash of the file, in hexadecimal."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def check_model(self, bundle: Path, manifest: Manifest) -> None:
        """Check that the file and a bundle were made from the same weights, and have the same graphs.

        Raises ArtifactError.
        """
        if self.about.weights_sha256 != manifest.weights.sha256:
            raise ArtifactError(
                f"{self.path}: expected the weights of {bundle}, {manifest.weights.sha256[:12]}; got "
                f"{self.about.weights_sha256[:12]}. Use the file that the export of this bundle wrote."
            )
        if unknown := sorted({case.graph for case in self.cases} - manifest.graphs.keys()):
            raise ArtifactError(
                f"{self.path}: expected cases of the graphs of {bundle}; got some of a graph {unknown[0]!r}. Use the "
                "file that the export of this bundle wrote."
            )

    def inputs(self, case: CaseRecord, graph: GraphSpec) -> dict[str, NDArray]:
        """Read the inputs of a case by name. graph: the bundle's entry of the graph. Raises ArtifactError."""
        return self._tensors(case.name, case.inputs, graph.inputs)

    def outputs(self, case: CaseRecord, graph: GraphSpec) -> dict[str, NDArray]:
        """Read the outputs of eager PyTorch for a case by name. Raises ArtifactError."""
        return self._tensors(case.name, case.outputs, graph.outputs)

    def heading(self, record: CaseRecord | StreamFrameRecord, manifest: Manifest) -> NDArray | None:
        """Read the lengths (Q) of the vectors (sin θ, cos θ) of a case or a frame. None if it has no boxes.

        Raises ArtifactError.
        """
        if record.heading is None:
            return None
        (boxes,) = (spec for spec in manifest.graphs["decoder"].outputs if spec.name == "boxes")
        return self._archive.read(record.heading, boxes.shape[:1], (boxes.dtype,))

    def frame(self, index: int, manifest: Manifest) -> StreamFrame:
        """Read frame `index` of the stress sequence. Raises ArtifactError."""
        record = self.about.stream[index]
        cameras = {
            name: Camera(
                np.array(camera.intrinsics_px), np.array(camera.camera_T_ego), camera.width_px, camera.height_px
            )
            for name, camera in record.cameras.items()
        }
        pose = np.array(record.global_T_ego)
        frame = Frame(self._images(record), cameras, pose, record.timestamp_s, record.scene, record.token)
        specs = [*manifest.graphs["decoder"].outputs]
        specs += manifest.graphs["segmenter"].outputs if "segmenter" in manifest.graphs else ()
        outputs = self._tensors(f"frame {index}", record.outputs, specs) if record.window else {}
        return StreamFrame(frame, record.window, outputs, self.heading(record, manifest))

    def _images(self, record: StreamFrameRecord) -> dict[str, NDArray[np.uint8] | None]:
        return {
            name: None
            if camera.image is None
            else self._archive.read(camera.image, (camera.height_px, camera.width_px, 3), ("uint8",))
            for name, camera in record.cameras.items()
        }

    def _tensors(self, where: str, names: Mapping[str, str], specs: Sequence[TensorSpec]) -> dict[str, NDArray]:
        if names.keys() != {spec.name for spec in specs}:
            different = sorted(names.keys() ^ {spec.name for spec in specs})
            raise ArtifactError(
                f"{self.path}: {where}: expected the tensors of the bundle's graph; got others, the first "
                f"{different[0]!r}. Use the file that the export of this bundle wrote."
            )
        return {spec.name: self._archive.read(names[spec.name], spec.shape, (spec.dtype,)) for spec in specs}


def about_text(record: GoldenFileRecord) -> str:
    """Return the text `about` of a golden file."""
    return json.dumps(record.model_dump(mode="json"))
