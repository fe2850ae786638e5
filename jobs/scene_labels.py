"""Labels of frames for the progress of a job: which scene of how many."""

from itertools import pairwise

from ..data.source import Source


class SceneLabels:
    """The label of a frame by its index in a source, such as "scene 3 of 10, scene-0103"."""

    def __init__(self, source: Source) -> None:
        self._source = source
        names = [source.scene_name(index) for index in range(len(source))]
        self._numbers = [1]
        for last, name in pairwise(names):
            self._numbers.append(self._numbers[-1] + (name != last))

    def __call__(self, index: int) -> str:
        return f"scene {self._numbers[index]} of {self._numbers[-1]}, {self._source.scene_name(index)}"
