"""The tables scene, log and sample: the frames of a version, scene by scene."""

from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .table import Place, Table, repeated_error
from .table_records import LogRow, SampleRow, SceneRow
from .table_set import TableSet


class SceneName(NamedTuple):
    """location: name of the map."""

    name: str
    location: str


class Frames(NamedTuple):
    """The F frames, sorted by scene name, then by time.

    path: of the table sample.
    scenes: sorted by name.
    scene_starts: (scenes + 1,) number of the first frame of each scene, and F.
    places: row number and token of each sample.
    timestamps_us: (F,).
    numbers: number of each frame, by token.
    """

    path: Path
    scenes: list[SceneName]
    scene_starts: NDArray[np.int64]
    places: list[Place]
    timestamps_us: NDArray[np.float64]
    numbers: dict[str, int]

    @property
    def tokens(self) -> list[str]:
        return [token for _, token in self.places]


def read_frames(tables: TableSet) -> Frames:
    """Raises InputError, naming the table, the row and the token."""
    scenes = _read_scenes(tables.open("scene", SceneRow), tables.open("log", LogRow))
    order = {token: number for number, token in enumerate(sorted(scenes, key=lambda token: scenes[token].name))}
    table = tables.open("sample", SampleRow)
    rows = list(table.by_token().values())
    keys = [(table.find(row, "scene_token", order, "scene"), row.row.timestamp, row.number) for row in rows]
    keys.sort()
    by_number = {row.number: row.row for row in rows}
    samples = [by_number[number] for _, _, number in keys]
    for (scene, time, first), (next_scene, next_time, number) in pairwise(keys):
        if (scene, time) == (next_scene, next_time):
            raise repeated_error(table.path, (number, by_number[number].token), first, "timestamp of a scene")
    scene_numbers = np.array([scene for scene, _, _ in keys], np.int64)
    return Frames(
        table.path,
        [scenes[token] for token in order],
        np.searchsorted(scene_numbers, np.arange(len(order) + 1)),
        [(number, sample.token) for (_, _, number), sample in zip(keys, samples, strict=True)],
        np.array([sample.timestamp for sample in samples], np.float64),
        {sample.token: number for number, sample in enumerate(samples)},
    )


def _read_scenes(table: Table[SceneRow], logs: Table[LogRow]) -> dict[str, SceneName]:
    """Return the scenes by token."""
    locations = {token: logs.check_name(log, "location") for token, log in logs.by_token().items()}
    scenes: dict[str, SceneName] = {}
    first_rows: dict[str, int] = {}
    for token, scene in table.by_token().items():
        name = table.check_name(scene, "name")
        if (first := first_rows.setdefault(name, scene.number)) != scene.number:
            raise repeated_error(table.path, scene.place, first, "name of a scene")
        scenes[token] = SceneName(name, table.find(scene, "log_token", locations, "log"))
    return scenes
