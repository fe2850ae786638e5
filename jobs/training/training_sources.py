"""The sources of a training, opened as one."""

from typing import TYPE_CHECKING

from ...data.joined_source import join_sources
from ...data.source import Source
from ...runtime.errors import InputError
from ...runtime.progress import Progress
from ..sources import SourceName, SourceNames, map_grid, open_source, source_names

if TYPE_CHECKING:
    from ...model import DuoSpaceNetConfig
    from ...training.tasks import Tasks


def open_training_sources(
    names: SourceNames, config: "DuoSpaceNetConfig", tasks: "Tasks", progress: Progress
) -> Source:
    """Open all sources as one.

    tasks: the tasks that are trained.
    progress: of the index of a nuScenes root.

    Raises InputError, naming the source, if it does not exist, if it has no ground truth of any trained task, or if
    class names of boxes that are trained on are unknown.
    """
    from ...training.source_clips import is_trainable

    grid = map_grid(config.voxels, config.map_classes) if tasks.maps else None
    opened = []
    for name in source_names(names):
        source = open_source(name, grid, progress)
        if not any(is_trainable(source, index, tasks) for index in range(len(source))):
            raise _missing_truth_error(name, source, tasks)
        if tasks.detection:
            source.check_class_names(config.classes)
        opened.append(source)
    return join_sources(opened)


def _missing_truth_error(name: SourceName, source: Source, tasks: "Tasks") -> InputError:
    kinds = {"boxes": tasks.detection, "masks": tasks.maps}
    expected = " or ".join(kind for kind, is_trained in kinds.items() if is_trained)
    return InputError(
        f"{name}: expected frames with ground-truth {expected} to train on; got none in {len(source)} frames. Leave "
        "this source out, or add its ground truth."
    )
