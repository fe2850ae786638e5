"""The input contract of a configuration: its preprocessing and its temporal window, for training and for export."""

from ..model import DuoSpaceNetConfig
from ..runtime.bundle.preprocessing_record import Normalisation, Preprocessing
from ..runtime.bundle.temporal_window import (
    LARGEST_SPEED_M_S,
    LARGEST_TIME_DELTA_S,
    LARGEST_TURN_RAD_S,
    NOMINAL_TIME_DELTA_S,
    TemporalWindow,
)


def preprocessing(config: DuoSpaceNetConfig) -> Preprocessing:
    """The conversion of camera images to the input images of a model with this configuration."""
    image = config.image
    return Preprocessing(
        width_px=image.width_px,
        height_px=image.height_px,
        colour_order="bgr",
        resize_shrinking="area by halvings",
        resize_enlarging="linear",
        crop="centre columns, bottom rows",
        normalisation_in_graph=Normalisation(colour_order=image.colour_order, mean=image.mean, std=image.std),
    )


def temporal_window(config: DuoSpaceNetConfig) -> TemporalWindow:
    """The number of frames in a model's temporal window, and the limits beyond which the history is reset."""
    return TemporalWindow(
        num_frames=config.num_frames,
        nominal_time_delta_s=NOMINAL_TIME_DELTA_S,
        largest_time_delta_s=LARGEST_TIME_DELTA_S,
        largest_speed_m_s=LARGEST_SPEED_M_S,
        largest_turn_rad_s=round(LARGEST_TURN_RAD_S, 4),  # rounded since schema 2; bundles are compared with it
    )
