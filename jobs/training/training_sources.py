"""The sources of a training, opened as one, and what is known of their ground truth."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

from ...data.joined_source import join_sources
from ...data.source import Source
from ...runtime.errors import InputError
from ...runtime.progress import Progress
from ..sources import SourceName, SourceNames, map_grid, open_source, source_names

if TYPE_CHECKING:
    from ...model import DuoSpaceNetConfig
    from ...training.tasks import Tasks


@dataclass(frozen=True)
class TrainingSources:
    """The sources of a training.

    source: all sources as one.
    with_boxes: the indices of the frames with known boxes; empty if detection is not trained.
    with_masks: the indices of the frames with a mask of one of the model's map classes; empty if maps are not trained.
    """

    source: Source
    with_boxes: frozenset[int]
    with_masks: frozenset[int]

    def trainable(self, tasks: "Tasks") -> frozenset[int]:
        """The indices of the frames with ground truth to train on."""
        nothing: frozenset[int] = frozenset()
        return (self.with_boxes if tasks.detection else nothing) | (self.with_masks if tasks.maps else nothing)


def open_training_sources(
    names: SourceNames, config: "DuoSpaceNetConfig", tasks: "Tasks", progress: Progress
) -> TrainingSources:
    """Open all sources as one.

    tasks: the tasks that are trained.
    progress: of the index of a nuScenes root.

    Raises InputError, naming the source, if it does not exist, if it has no ground truth of any trained task, or if
    class names of boxes that are trained on are unknown.
    """
    grid = map_grid(config.voxels, config.map_classes) if tasks.maps else None
    opened = []
    for name in source_names(names):
        source = open_source(name, grid, progress)
        opened.append(_known(source, config, tasks))
        if not opened[-1].trainable(tasks):
            raise _missing_truth_error(name, source, config, tasks)
        if tasks.detection:
            source.check_class_names(config.classes)
    return _join(opened)


def _known(source: Source, config: "DuoSpaceNetConfig", tasks: "Tasks") -> TrainingSources:
    indices = range(len(source))
    with_boxes = filter(source.has_boxes, indices) if tasks.detection else ()
    with_masks = _with_masks(source, config) if tasks.maps else ()
    return TrainingSources(source, frozenset(with_boxes), frozenset(with_masks))


def _join(opened: list[TrainingSources]) -> TrainingSources:
    """Several sources as one. The frames of each follow those of the sources before it."""
    starts = [0, *accumulate(len(part.source) for part in opened)]
    return TrainingSources(
        join_sources([part.source for part in opened]),
        frozenset(start + index for start, part in zip(starts, opened, strict=False) for index in part.with_boxes),
        frozenset(start + index for start, part in zip(starts, opened, strict=False) for index in part.with_masks),
    )


def _with_masks(source: Source, config: "DuoSpaceNetConfig") -> Iterator[int]:
    for index in range(len(source)):
        if not source.map_names(index).isdisjoint(config.map_classes):
            yield index


def _missing_truth_error(name: SourceName, source: Source, config: "DuoSpaceNetConfig", tasks: "Tasks") -> InputError:
    masks = f"masks of {' or '.join(config.map_classes)}"
    expected = " or ".join(("boxes",) * tasks.detection + (masks,) * tasks.maps)
    return InputError(
        f"{name}: expected ground-truth {expected} in at least one frame; got none in {len(source)} frames. Leave this "
        "source out, or add its ground truth."
    )
