"""Manifests of older schema versions, made from a manifest of the current one."""

from typing import Any

# By schema version, the fields of the contract that it added. The parity report is left out.
ADDED_FIELDS: dict[int, tuple[str, ...]] = {
    2: (
        "window.largest_turn_rad_s",
        "dcn",
        "weights.checkpoint",
        "weights.anchors",
        "graphs.lifter.opsets",
        "sha256",
    ),
    3: ("weights.checkpoint.ignored", "weights.checkpoint.weights_key"),
    4: ("attention", "quantization"),
    5: (
        "preprocessing.scaling",
        "preprocessing.size_rounding",
        "preprocessing.crop_rounding",
        "preprocessing.pixel_centres",
        "window.slots",
        "window.speed",
        "window.turn",
        "window.above_largest",
        "window.new_scene",
        "window.time_stamp_not_later",
        "window.frame_without_images",
        "axes",
        "selection",
        "boxes",
        "maps",
        "golden",
    ),
}


def downgrade(manifest: dict[str, Any], version: int) -> None:
    """Remove from the JSON of a manifest all fields that are newer than a schema version."""
    manifest["schema_version"] = version
    for fields in (fields for since, fields in ADDED_FIELDS.items() if since > version):
        for field in fields:
            *path, name = field.split(".")
            for parent in _parents(manifest, path):
                parent.pop(name, None)


def _parents(manifest: dict[str, Any], path: list[str]) -> list[dict[str, Any]]:
    """The objects that hold a field; those of all graphs for a field of one graph."""
    if path[:1] == ["graphs"]:
        return list(manifest["graphs"].values())
    value: Any = manifest
    for key in path:
        value = value.get(key) or {}
    return [value]
