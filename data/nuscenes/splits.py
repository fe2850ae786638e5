"""The scenes of a nuScenes root that a source uses: a published split, a split of the root's own, or scene names.

The published splits are lists of scene names. They are stored here as ranges of their numbers.
Source: nuscenes-devkit 1.2.0 (nuscenes/utils/splits.py).
"""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import msgspec

from ...runtime.errors import InputError
from ...runtime.files import read_regular_file
from ...runtime.printable import printable, shortened
from .table import PARSER_ERRORS

OWN_SPLITS_NAME = "splits.json"  # in the version folder: scene names by split, as nuscenes-devkit reads it
MAX_OWN_SPLITS_BYTES = 10**8
MAX_LISTED_NAMES = 10

SCENE_NUMBERS: Mapping[str, str] = MappingProxyType(
    {
        "train": (
            "1-2 4-11 19-34 41-76 120-135 138-139 149-152 154-155 157-168 170-185 187-188 190-196 199-200 202-204 "
            "206-214 218-220 222 224-264 283-306 315-318 321 323-324 328 347-386 388-403 405-408 410-459 461-465 "
            "467-469 471-472 474-480 499-502 504-515 517-518 525-539 541-546 566 568 570-578 580 582-600 639-679 "
            "681 683-689 695-698 700-701 703-719 726-728 730-731 733-741 744 746-747 749-752 757-765 767-769 "
            "786-787 789-792 803-806 808-813 815-817 819-822 847-856 858 860-866 868-873 875-878 880 882-903 945 "
            "947 949 952-953 955-961 975-984 988-992 994-1025 1044-1058 1074-1102 1104-1110"
        ),
        "val": (
            "3 12-18 35-36 38-39 92-110 221 268-278 329-332 344-346 519-524 552-565 625-627 629-630 632-638 "
            "770-771 775 777-778 780-784 794-800 802 904-917 919-931 962-963 966-969 971-972 1059-1073"
        ),
        "test": (
            "77-91 111-119 140 142-148 265-266 279-282 307-314 333-343 481-498 547-551 601-604 606-624 827-831 "
            "833-842 844-846 932-933 935-943 1026-1043"
        ),
        "mini_train": "61 553 655 757 796 1077 1094 1100",
        "mini_val": "103 916",
    }
)


def published_split(name: str) -> tuple[str, ...]:
    """Return the scene names of a published split, in ascending order. Raises KeyError for another name."""
    return tuple(f"scene-{number:04d}" for number in _numbers(SCENE_NUMBERS[name]))


def choose_scenes(split: str | None, scenes: Sequence[str], folder: Path) -> tuple[str, ...]:
    """Return the names of the scenes that a source uses, in the order of their frames.

    split: a published split, a split of the root's own, or scene names separated by commas; None for all scenes.
    scenes: the names of all scenes of the root.
    folder: the version folder.

    The scenes of a split are in ascending order. Named scenes keep their order.
    Raises InputError for an unknown split or scene, for a scene that is named twice, and for a split without any
    scene in this root.
    """
    if split is None:
        return tuple(sorted(scenes))
    own = _read_own_splits(folder)
    if split in own or split in SCENE_NUMBERS:
        names = tuple(own[split]) if split in own else published_split(split)
        return _scenes_of_split(split, names, scenes, folder)
    names = tuple(name.strip() for name in split.split(","))
    known = set(scenes)
    for name in names:
        if name not in known:
            raise InputError(_unknown_message(name, scenes, own, folder))
    if len(set(names)) < len(names):
        repeated = next(name for name in names if names.count(name) > 1)
        raise InputError(f"{folder}: expected each scene once; got {repeated} several times. Name it once.")
    return names


def _scenes_of_split(split: str, names: Sequence[str], scenes: Sequence[str], folder: Path) -> tuple[str, ...]:
    known = set(scenes)
    chosen = tuple(sorted(name for name in set(names) if name in known))
    if not chosen:
        fitting = ", ".join(_fitting_splits(known, _read_own_splits(folder))) or "none"
        raise InputError(
            f"{folder}: expected scenes of the split {printable(split)}; got a version that has none of its "
            f"{len(names)} scenes. Splits with scenes here: {fitting}."
        )
    return chosen


def _fitting_splits(known: set[str], own: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """Yield the names of the splits that have scenes in the root."""
    yield from (printable(name) for name, scenes in own.items() if known.intersection(scenes))
    yield from (name for name in SCENE_NUMBERS if name not in own and known.intersection(published_split(name)))


def _unknown_message(name: str, scenes: Sequence[str], own: Mapping[str, Sequence[str]], folder: Path) -> str:
    splits = tuple(dict.fromkeys((*own, *SCENE_NUMBERS)))
    if name in splits:
        return (
            f"{folder}: expected one split, or scene names separated by commas; got the split {printable(name)} "
            "together with other names. Give each split as a separate source."
        )
    candidates = [*splits, *scenes]
    in_lower_case = [candidate for candidate in candidates if candidate.lower() == name.lower()]
    similar = in_lower_case or difflib.get_close_matches(name, candidates, n=3, cutoff=0.5)
    listed = sorted(scenes)[:MAX_LISTED_NAMES]
    more = f" and {len(scenes) - len(listed)} more" if len(scenes) > len(listed) else ""
    hint = f" Similar names: {printable(', '.join(similar))}." if similar else ""
    return (
        f"{folder}: expected a split ({printable(', '.join(splits))}) or names of its scenes "
        f"({printable(', '.join(listed))}{more}); got {shortened(name)}.{hint}"
    )


def _read_own_splits(folder: Path) -> dict[str, list[str]]:
    """Return the scene names of the root's own splits, by name; empty without such a file."""
    path = folder / OWN_SPLITS_NAME
    if not path.exists():
        return {}
    try:
        return msgspec.json.decode(read_regular_file(path, MAX_OWN_SPLITS_BYTES, InputError), type=dict[str, list[str]])
    except PARSER_ERRORS as error:
        raise InputError(
            f"{path}: expected lists of scene names by split; got something else ({printable(str(error))})."
        ) from None


def _numbers(ranges: str) -> Iterator[int]:
    for part in ranges.split():
        first, _, last = part.partition("-")
        yield from range(int(first), int(last or first) + 1)
