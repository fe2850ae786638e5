"""Rasterises layers of a map around poses with the devkit, and prints the masks as JSON.

Usage: map_masks.py ROOT LOCATION POSES SIZE LAYER... POSES is a JSON list of [x, y, yaw in degrees]; SIZE is the number
of cells of a square of 102.4 m. Each mask is printed as base64 of its packed bits; its first axis is y (left).
"""

# pyright: reportMissingImports=false

import base64
import json
import sys

import numpy as np
from nuscenes.map_expansion.map_api import NuScenesMap, NuScenesMapExplorer


class IterableLines(NuScenesMapExplorer):
    """Draws a line that leaves the rectangle and comes back. Its parts cannot be iterated over in shapely 2."""

    @staticmethod
    def mask_for_lines(lines, mask):
        for line in getattr(lines, "geoms", [lines]):
            NuScenesMapExplorer.mask_for_lines(line, mask)
        return mask


def main(root: str, location: str, poses: str, size: str, *layers: str) -> None:
    api = NuScenesMap(root, location)
    api.explorer = IterableLines(api)
    canvas = (int(size), int(size))
    masks = [api.get_map_mask((x, y, 102.4, 102.4), yaw, list(layers), canvas) for x, y, yaw in json.loads(poses)]
    json.dump([[base64.b64encode(np.packbits(layer)).decode() for layer in mask] for mask in masks], sys.stdout)


if __name__ == "__main__":
    main(*sys.argv[1:])
