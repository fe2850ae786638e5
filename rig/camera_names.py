"""The directions in camera names, such as "front" or "left"."""

import re

import numpy as np

AZIMUTH_DEG = {  # by word in a camera's name; positive to the left
    **dict.fromkeys(("front", "forward", "ahead"), 0.0),
    **dict.fromkeys(("back", "rear", "backward"), 180.0),
    "left": 90.0,
    "right": -90.0,
}


def azimuth_from_name(name: str) -> float | None:
    """The azimuth [deg] that a camera's name says, or None. "CAM_FRONT_LEFT" gives 45."""
    azimuths = np.radians([AZIMUTH_DEG[word] for word in direction_words(name)])
    x, y = np.cos(azimuths).sum(), np.sin(azimuths).sum()
    # Opposite words, as in "left_right", cancel out and give no direction.
    return float(np.degrees(np.arctan2(y, x))) if np.hypot(x, y) >= 0.5 else None


def direction_words(name: str) -> list[str]:
    """The words of a camera's name that say a direction, in lower case."""
    snake_case = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
    return [word for word in re.findall(r"[a-z]+", snake_case.lower()) if word in AZIMUTH_DEG]


def difference_deg(one_deg: float, other_deg: float) -> float:
    """The absolute difference of two angles, in [0, 180]."""
    return abs((one_deg - other_deg + 180) % 360 - 180)
