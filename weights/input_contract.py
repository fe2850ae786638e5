"""What a configuration fixes for everyone who feeds its model: preprocessing and temporal window."""

from ..model import DuoSpaceNetConfig
from ..runtime.bundle.manifest import (
    LARGEST_SPEED_M_S,
    LARGEST_TIME_DELTA_S,
    LARGEST_TURN_RAD_S,
    NOMINAL_TIME_DELTA_S,
    Preprocessing,
    TemporalWindow,
)


def preprocessing(config: DuoSpaceNetConfig) -> Preprocessing:
    """How pictures become the images of `config`."""
    image = config.image
    return Preprocessing(
        width_px=image.width_px,
        height_px=image.height_px,
        colour_order="bgr",
        resize_shrinking="area",
        resize_enlarging="linear",
        crop="centre columns, bottom rows",
        normalisation_in_graph={"colour_order": image.colour_order, "mean": image.mean, "std": image.std},
    )


def temporal_window(config: DuoSpaceNetConfig) -> TemporalWindow:
    """nuScenes' key frames come at 2 Hz; no road vehicle moves 70 m in a second, or turns half around."""
    return TemporalWindow(
        num_frames=config.num_frames,
        nominal_time_delta_s=NOMINAL_TIME_DELTA_S,
        largest_time_delta_s=LARGEST_TIME_DELTA_S,
        largest_speed_m_s=LARGEST_SPEED_M_S,
        largest_turn_rad_s=round(LARGEST_TURN_RAD_S, 4),
    )
