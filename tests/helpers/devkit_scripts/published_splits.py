"""Prints the scene names of the published splits as JSON."""

import json

from nuscenes.utils.splits import create_splits_scenes

NAMES = ("train", "val", "test", "mini_train", "mini_val")

print(json.dumps({name: create_splits_scenes()[name] for name in NAMES}))  # noqa: T201
