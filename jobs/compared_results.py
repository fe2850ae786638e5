"""The results of several runs over the same frames, read for a comparison."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..data.results import FrameResult, read_results, result_boxes
from ..data.source import Source
from ..runtime.errors import InputError, OutputError, UsageError
from ..runtime.files import check_regular_file
from ..runtime.frame import Frame
from ..runtime.printable import printable, shortened
from .run_folder import RESULTS_NAME

MAX_RESULTS_BYTES = 2**36
POSE_TOLERANCE = 1e-6  # of a pose's numbers, relative and absolute


class FrameKey(NamedTuple):
    """What tells the frames of a source apart."""

    scene: str
    token: str
    timestamp_s: float

    def describe(self) -> str:
        """The frame for a message."""
        return f"frame {shortened(self.token)} of scene {shortened(self.scene)} at {self.timestamp_s!r} s"


class FrameBoxes(NamedTuple):
    """The boxes of one frame in one result, highest score first.

    boxes: (D, 9) in the ego frame: x y z w l h [m], yaw [rad], vx vy [m/s].
    scores: (D,). classes: D names.
    global_T_ego: (4, 4).
    """

    boxes: NDArray[np.float64]
    scores: NDArray[np.float64]
    classes: tuple[str, ...]
    global_T_ego: NDArray[np.float64]


@dataclass(frozen=True)
class ComparedResults:
    """One result: its name, its file, and its frames in their order."""

    name: str
    path: Path
    frames: dict[FrameKey, FrameBoxes]


def split_names(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split arguments into results, which come first, and sources.

    Results are folders with `results.jsonl`, and files that end with .jsonl.
    Raises UsageError if there are no results before the first source, or no sources after them.
    """
    number = next((place for place, name in enumerate(names) if not _is_results(name)), len(names))
    results, sources = list(names[:number]), list(names[number:])
    misplaced = [name for name in sources if _is_results(name)]
    if not results:
        raise UsageError(f"expected results of run, then their source; {shortened(sources[0])} has no {RESULTS_NAME}.")
    if not sources:
        raise UsageError("expected the sources of the results after them; got results only.")
    if misplaced:
        raise UsageError(
            f"expected results before sources; got {shortened(misplaced[0])} after {shortened(sources[0])}, which has "
            f"no {RESULTS_NAME}."
        )
    return results, sources


def read_compared(paths: Sequence[Path], names: Sequence[str], min_score: float) -> list[ComparedResults]:
    """Read results, and check that all have the same frames.

    paths: folders of `run`, or their `results.jsonl`.
    names: one per path, or none to use the names of the folders.
    min_score: boxes with a lower score are left out.
    Raises UsageError if there is not one name per path. Raises InputError for a file that is not the results of a run,
    and for results with other frames than the first ones.
    """
    if names and len(names) != len(paths):
        raise UsageError(f"--name: expected one name per result, {len(paths)}; got {len(names)}.")
    files = [path / RESULTS_NAME if path.is_dir() else path for path in paths]
    titles = list(names) or _folder_names(files)
    results = [
        ComparedResults(printable(title), file, _read(file, min_score))
        for title, file in zip(titles, files, strict=True)
    ]
    for other in results[1:]:
        _check_same_frames(results[0], other)
    return results


def frame_keys(source: Source) -> list[FrameKey]:
    """The keys of all frames of a source, in order."""
    return [_key(source.frame_without_images(index)) for index in range(len(source))]


def choose_frames(keys: Sequence[FrameKey], chosen: Sequence[str], results: Sequence[ComparedResults]) -> list[int]:
    """Return the indices of the chosen frames of a source; by default, of all frames in the results.

    keys: of the frames of the source.
    chosen: tokens, or indices counted from 0. A token comes first if it reads as an index as well.
    Raises UsageError for a choice that is no frame, or several. Raises InputError if the results have frames that the
    source lacks, or lack a chosen frame.
    """
    known, first = set(keys), results[0]
    for key in first.frames:
        if key not in known:
            raise InputError(
                f"{first.path}: expected only frames of the source; got {key.describe()}. "
                "After the results, give all sources of the runs."
            )
    if not chosen:
        return [index for index, key in enumerate(keys) if key in first.frames]
    indices = list(dict.fromkeys(_find(keys, choice) for choice in chosen))
    for index in indices:
        if keys[index] not in first.frames:
            raise InputError(
                f"{first.path}: expected {keys[index].describe()}, which --frame names; it has no such line."
            )
    return indices


def check_pose(results: ComparedResults, key: FrameKey, frame: Frame) -> None:
    """Check that boxes were computed for the ego pose of this frame of the source. Raises InputError."""
    pose = results.frames[key].global_T_ego
    if pose.shape != (4, 4) or not np.allclose(pose, frame.global_T_ego, rtol=POSE_TOLERANCE, atol=POSE_TOLERANCE):
        raise InputError(
            f"{results.path}: {key.describe()}: expected the ego pose of the source; got another global_T_ego. "
            "The boxes would be in the wrong place. Run the bundle again on this source."
        )


def _is_results(name: str) -> bool:
    path = Path(name)
    return path.suffix == ".jsonl" or (path / RESULTS_NAME).is_file()


def _read(path: Path, min_score: float) -> dict[FrameKey, FrameBoxes]:
    check_regular_file(path, MAX_RESULTS_BYTES, InputError)
    frames: dict[FrameKey, FrameBoxes] = {}
    for number, line in enumerate(_lines(path), start=1):
        key = FrameKey(line["scene"], line["token"], float(line["timestamp_s"]))
        if key in frames:
            raise InputError(f"{path}: line {number}: expected each frame once; got {key.describe()} again.")
        frames[key] = _frame_boxes(line, min_score)
    if not frames:
        raise InputError(f"{path}: expected the results of a run; got an empty file.")
    return frames


def _lines(path: Path) -> Iterator[FrameResult]:
    try:
        yield from read_results(path)
    except OutputError as error:  # for `run`, which would continue the file; here it is an input
        raise InputError(str(error)) from None


def _frame_boxes(line: FrameResult, min_score: float) -> FrameBoxes:
    boxes, scores, classes, _ = result_boxes(line, min_score)
    return FrameBoxes(boxes, scores, classes, np.array(line["global_T_ego"], np.float64))


def _folder_names(files: Sequence[Path]) -> list[str]:
    """The names of the folders, or the whole paths of those whose names are equal."""
    folders = [file.absolute().parent.name if file.name == RESULTS_NAME else file.stem for file in files]
    counts = Counter(folders)
    return [name if counts[name] == 1 else str(file) for name, file in zip(folders, files, strict=True)]


def _check_same_frames(first: ComparedResults, other: ComparedResults) -> None:
    for one, two in ((first, other), (other, first)):
        for key in one.frames:
            if key not in two.frames:
                raise InputError(
                    f"{two.path}: expected the same frames as {one.path}; got {len(two.frames)} instead of "
                    f"{len(one.frames)}, without {key.describe()}. Run both over the same source, to the end."
                )


def _find(keys: Sequence[FrameKey], choice: str) -> int:
    with_token = [index for index, key in enumerate(keys) if key.token == choice]
    if len(with_token) == 1:
        return with_token[0]
    if with_token:
        raise UsageError(
            f"--frame: expected a token of one frame; got {shortened(choice)} of frames "
            f"{', '.join(map(str, with_token[:5]))}. Choose one by its index."
        )
    if choice.isascii() and choice.isdigit() and int(choice) < len(keys):
        return int(choice)
    raise UsageError(f"--frame: expected a token, or an index from 0 to {len(keys) - 1}; got {shortened(choice)}.")


def _key(frame: Frame) -> FrameKey:
    return FrameKey(frame.scene, frame.token, float(frame.timestamp_s))
