"""The requirements on a rig: those of a bundle, or default values if there is no bundle."""

from dataclasses import dataclass

from ..runtime.bundle.manifest import Manifest, PerceptionRange
from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.bundle.temporal_window import LARGEST_SPEED_M_S, LARGEST_TIME_DELTA_S, LARGEST_TURN_RAD_S

DEFAULT_RANGE = PerceptionRange(size=(100, 100, 4), lower_m=(-51.2, -51.2, -3.0), upper_m=(51.2, 51.2, 5.0))


@dataclass(frozen=True)
class RigRequirements:
    """The parts of a manifest that concern the rig.

    perception: the default is the range of the preset `small`.
    preprocessing: None for whole images, without a crop.
    num_cameras: the largest number of cameras; None accepts any number.
    classes: of the ground truth; None for the ten classes of nuScenes.
    """

    perception: PerceptionRange = DEFAULT_RANGE
    preprocessing: Preprocessing | None = None
    num_cameras: int | None = None
    classes: tuple[str, ...] | None = None
    largest_time_delta_s: float = LARGEST_TIME_DELTA_S
    largest_speed_m_s: float = LARGEST_SPEED_M_S
    largest_turn_rad_s: float = LARGEST_TURN_RAD_S

    @classmethod
    def from_manifest(cls, manifest: Manifest) -> "RigRequirements":
        """The requirements of a bundle."""
        window = manifest.window
        return cls(
            manifest.perception,
            manifest.preprocessing,
            manifest.num_cameras,
            manifest.classes,
            window.largest_time_delta_s,
            window.largest_speed_m_s,
            window.largest_turn_rad_s,
        )
