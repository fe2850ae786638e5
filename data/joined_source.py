"""Several sources as one: their frames one after the other. The history is reset between them."""

from bisect import bisect_right
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import accumulate, chain

from ..runtime.frame import Frame, GroundTruth
from .source import Source


class JoinedSource:
    """The frames of several sources, in the order of the sources.

    A new scene resets the history. So the first scene of a source must differ in name from the last scene before it:
    if a source has a scene name that an earlier source has too, the number of the source is added to it, as in
    "scene-0061 (source 2)". Results then also show which source a frame belongs to.
    """

    def __init__(self, sources: Sequence[Source]) -> None:
        """sources: at least one."""
        self._sources = tuple(sources)
        self._ends = list(accumulate(map(len, self._sources)))
        self._renamed = _repeated_scenes(self._sources)

    @property
    def identity(self) -> str:
        """The identities of all sources, in order."""
        return " + ".join(source.identity for source in self._sources)

    @property
    def tokens(self) -> Iterator[str]:
        return chain.from_iterable(source.tokens for source in self._sources)

    def __len__(self) -> int:
        return self._ends[-1]

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, range(len(self)))

    def frame(self, index: int) -> Frame:
        """Return frame `index`, counted from 0 over all sources."""
        number, local = self._place(index)
        return self._rename(number, self._sources[number].frame(local))

    def frame_without_images(self, index: int) -> Frame:
        """Return frame `index` without images and ground truth."""
        number, local = self._place(index)
        return self._rename(number, self._sources[number].frame_without_images(local))

    def scene_name(self, index: int) -> str:
        """Return the scene of frame `index`, which no other source has."""
        number, local = self._place(index)
        name = self._sources[number].scene_name(local)
        return self._renamed[number].get(name, name)

    def check_image_files(self, index: int) -> tuple[str, ...]:
        """Check the image files of frame `index`. Returns the names of the lost cameras. Raises InputError."""
        number, local = self._place(index)
        return self._sources[number].check_image_files(local)

    def has_boxes(self, index: int) -> bool:
        """Return whether the ground-truth boxes of frame `index` are known."""
        number, local = self._place(index)
        return self._sources[number].has_boxes(local)

    def has_maps(self, index: int) -> bool:
        """Return whether any ground-truth map of frame `index` is known."""
        number, local = self._place(index)
        return self._sources[number].has_maps(local)

    def map_names(self, index: int) -> frozenset[str]:
        """Return the names of the known ground-truth maps of frame `index`."""
        number, local = self._place(index)
        return self._sources[number].map_names(local)

    def ground_truth_without_maps(self, index: int) -> GroundTruth | None:
        """Return the ground truth of frame `index` without maps, or None if its boxes are unknown."""
        number, local = self._place(index)
        return self._sources[number].ground_truth_without_maps(local)

    def check_class_names(self, classes: Collection[str]) -> None:
        """Check the class names of every source. Raises InputError."""
        for source in self._sources:
            source.check_class_names(classes)

    def _place(self, index: int) -> tuple[int, int]:
        """The number of the source of frame `index`, and the index of the frame in it."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        number = bisect_right(self._ends, index)
        return number, index - (self._ends[number] - len(self._sources[number]))

    def _rename(self, number: int, frame: Frame) -> Frame:
        name = self._renamed[number].get(frame.scene)
        return frame if name is None else replace(frame, scene=name)


def join_sources(sources: Sequence[Source]) -> Source:
    """Return the only source, or several sources as one."""
    return sources[0] if len(sources) == 1 else JoinedSource(sources)


def _repeated_scenes(sources: Sequence[Source]) -> list[dict[str, str]]:
    """By source, the new names of the scenes whose names an earlier source uses too."""
    used: set[str] = set()
    renamed = []
    for number, source in enumerate(sources, start=1):
        names = dict.fromkeys(source.scene_name(index) for index in range(len(source)))
        new_names = {name: _unused(name, f" (source {number})", used | names.keys()) for name in names if name in used}
        used |= {new_names.get(name, name) for name in names}
        renamed.append(new_names)
    return renamed


def _unused(name: str, suffix: str, used: Collection[str]) -> str:
    """The name with as many suffixes as it needs."""
    while name in used:
        name += suffix
    return name
