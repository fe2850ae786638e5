"""Trained parts: which parts of a model have been trained, as the metadata of weights files says.

A training may change some parts only: the image encoder in a pretraining, or all parts but the map segmentation in a
training of detection alone. The other parts keep the values that they started from.
"""

from collections.abc import Collection, Mapping
from typing import Literal, get_args

from ..model import DuoSpaceNetConfig
from .checkpoint_report import CheckpointReport

Part = Literal["image_encoder", "lifter", "divergence_enhancement", "queries", "decoder", "segmentation"]
PARTS: tuple[str, ...] = get_args(Part)
TRAINED = "trained"  # metadata: "true", "false" or "unknown", for the whole model
UNTRAINED = "untrained"  # metadata: the names of the untrained parts, if the training knows them

NO_ANCHORS = {"anchors": "false"}  # metadata: the queries have random positions

IsTrained = dict[str, bool | None]  # by part; None = unknown


def model_parts(config: DuoSpaceNetConfig) -> tuple[str, ...]:
    """The parts of a model: its direct children with parameters."""
    bev = ("lifter", "divergence_enhancement") if config.has_bev else ()
    return ("image_encoder", *bev, "queries", "decoder", *(("segmentation",) if config.map_classes else ()))


def loaded_parts(config: DuoSpaceNetConfig, report: CheckpointReport | None) -> IsTrained:
    """Which parts of a model are trained after a checkpoint has been loaded.

    report: the report on the checkpoint; None without a checkpoint, which leaves all parts untrained. A part with
        missing tensors is untrained. Files of other code bases do not say whether they are trained.
    """
    if report is None:
        return dict.fromkeys(model_parts(config), False)
    of_file = {"true": True, "false": False}.get(report.metadata.get(TRAINED, ""))
    listed = untrained_parts(report.metadata)
    others = True if listed else of_file
    incomplete = {name.partition(".")[0] for name in report.allowed_missing}
    return {part: False if part in {*listed, *incomplete} else others for part in model_parts(config)}


def trained_parts(start: Mapping[str, bool | None], config: DuoSpaceNetConfig, unchanged: Collection[str]) -> IsTrained:
    """Which parts of a model are trained after a training.

    start: the parts that were trained before it, from `loaded_parts`; a part that is not in it was untrained.
    unchanged: the parts that the training does not change.
    """
    return {part: start.get(part, False) if part in unchanged else True for part in model_parts(config)}


def parts_metadata(parts: Mapping[str, bool | None]) -> dict[str, str]:
    """The metadata of a weights file: `trained`, and `untrained` if some parts are known to be untrained."""
    untrained = [part for part, is_trained in parts.items() if is_trained is False]
    if untrained:
        return {TRAINED: "false", UNTRAINED: ", ".join(untrained)}
    return {TRAINED: "unknown" if None in parts.values() else "true"}


def untrained_parts(metadata: Mapping[str, str]) -> list[str]:
    """The parts that a weights file says are untrained. Other names in the metadata are ignored."""
    listed = {name.strip() for name in metadata.get(UNTRAINED, "").split(",")}
    return [part for part in PARTS if part in listed]


def lacks_anchors(metadata: Mapping[str, str]) -> bool:
    """Whether a weights file says that its queries have random positions, and not those of anchors."""
    return NO_ANCHORS.items() <= metadata.items()
