"""The annotations of a scene: which objects are annotated in which frames, linked to tracks."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...runtime.geometry import quaternion_from_rotation, rotation_z
from ..road import SEED_OFFSET
from .annotated_object import AnnotatedObject
from .object_attributes import choose_attribute
from .root_tables import RootTables, make_token, visibility_token

LONGEST_GAP = 3  # frames without points in which an object is still annotated; its annotations pause in a longer gap

FramesOfObject = dict[int, AnnotatedObject]


class Tracks:
    """Collects the objects of a scene frame by frame, and adds their rows at the end.

    An object is annotated from the first to the last frame in which it has lidar or radar points, so some annotations
    in between have none. After a long gap, the annotations of the same instance continue.
    """

    def __init__(self, seed: int, name: str) -> None:
        """seed, name: of the scene."""
        self._seed = seed
        self._name = name
        self._objects: dict[tuple[int, ...], FramesOfObject] = {}

    def add_frame(self, index: int, objects: Sequence[AnnotatedObject]) -> None:
        """Collect the objects of a key frame."""
        for item in objects:
            self._objects.setdefault(item.identity, {})[index] = item

    def add_rows(self, tables: RootTables, sample_tokens: Sequence[str]) -> None:
        """Add the rows of instance and sample_annotation.

        sample_tokens: of the key frames, in order.
        """
        for identity, frames in self._objects.items():
            annotated = {index: frames[index] for index in _annotated_frames(frames)}
            if annotated:
                self._add_track(tables, identity, annotated, sample_tokens)

    def _add_track(
        self,
        tables: RootTables,
        identity: tuple[int, ...],
        annotated: FramesOfObject,
        sample_tokens: Sequence[str],
    ) -> None:
        tokens = [make_token("sample_annotation", self._name, *identity, index) for index in annotated]
        instance_token = make_token("instance", self._name, *identity)
        category = next(iter(annotated.values())).category
        tables.add(
            "instance",
            token=instance_token,
            category_token=make_token("category", category),
            nbr_annotations=len(tokens),
            first_annotation_token=tokens[0],
            last_annotation_token=tokens[-1],
        )
        neighbours = zip(annotated.items(), tokens, ["", *tokens[:-1]], [*tokens[1:], ""], strict=True)
        for (index, item), token, previous, following in neighbours:
            tables.add(
                "sample_annotation",
                token=token,
                sample_token=sample_tokens[index],
                instance_token=instance_token,
                visibility_token=visibility_token(item.visible_share),
                attribute_tokens=self._attribute_tokens(item),
                translation=item.box[:3].tolist(),
                size=item.box[3:6].tolist(),
                rotation=quaternion_from_rotation(rotation_z(float(item.box[6]))).tolist(),
                prev=previous,
                next=following,
                num_lidar_pts=item.num_lidar_points,
                num_radar_pts=item.num_radar_points,
            )

    def _attribute_tokens(self, item: AnnotatedObject) -> list[str]:
        rng = np.random.default_rng([self._seed, 12, *(part + SEED_OFFSET for part in item.identity)])
        attribute = choose_attribute(item, rng)
        return [make_token("attribute", attribute)] if attribute else []


def _annotated_frames(frames: FramesOfObject) -> Iterator[int]:
    """The frames in which an object is annotated, in order."""
    hit = [index for index, item in frames.items() if item.num_lidar_points + item.num_radar_points > 0]
    for index, following in zip(hit, [*hit[1:], None], strict=False):
        yield index
        if following is not None and following - index - 1 <= LONGEST_GAP:
            yield from (between for between in range(index + 1, following) if between in frames)
