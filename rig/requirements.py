"""What a rig is measured against: the network that shall look through it, or the paper's usual one."""

from dataclasses import dataclass

from ..runtime.bundle.manifest import (
    LARGEST_SPEED_M_S,
    LARGEST_TIME_DELTA_S,
    LARGEST_TURN_RAD_S,
    Manifest,
    PerceptionRange,
    Preprocessing,
)

USUAL_RANGE = PerceptionRange(size=(100, 100, 4), lower_m=(-51.2, -51.2, -3.0), upper_m=(51.2, 51.2, 5.0))


@dataclass(frozen=True)
class RigRequirements:
    """The part of a bundle's manifest that a rig must suit.

    preprocessing: None where whole pictures count; num_cameras: None where any number is fine.
    """

    perception: PerceptionRange = USUAL_RANGE
    preprocessing: Preprocessing | None = None
    num_cameras: int | None = None
    largest_time_delta_s: float = LARGEST_TIME_DELTA_S
    largest_speed_m_s: float = LARGEST_SPEED_M_S
    largest_turn_rad_s: float = LARGEST_TURN_RAD_S

    @classmethod
    def from_manifest(cls, manifest: Manifest) -> "RigRequirements":
        """What the network of a bundle requirements."""
        window = manifest.window
        return cls(
            manifest.perception,
            manifest.preprocessing,
            manifest.num_cameras,
            window.largest_time_delta_s,
            window.largest_speed_m_s,
            window.largest_turn_rad_s,
        )
