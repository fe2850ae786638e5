"""Compares the viewing directions of cameras with the directions in their names, such as "front" or "left"."""

from collections.abc import Iterator

from .calibration import CheckedCalibration
from .camera_names import azimuth_from_name, difference_deg, direction_words
from .camera_pairs import COMPARE_PICTURES
from .findings import Finding, Verdict
from .formatting import describe_azimuth

# Largest angles between a viewing direction and the direction in the name. A name with only left or right has a larger
# limit, because both cameras of a stereo pair look ahead.
LARGEST_OFFSET_DEG = 75.0
LARGEST_SIDE_OFFSET_DEG = 100.0
COMPARED_DIRECTION = "direction compared with"  # subject of a finding, before the name of the other camera
LEAST_SWAP_GAIN_DEG = (
    40.0  # two cameras count as swapped if swapping reduces the sum of their offsets by more than this
)


def direction_findings(calibration: CheckedCalibration) -> Iterator[Finding]:
    """Yield a finding if a camera does not look in the direction that its name says."""
    named_deg = azimuth_from_name(calibration.name)
    if named_deg is None or not calibration.has_reliable_direction:
        return
    azimuth_deg = calibration.pose.azimuth_deg
    has_only_side = not set(direction_words(calibration.name)) - {"left", "right"}
    limit_deg = LARGEST_SIDE_OFFSET_DEG if has_only_side else LARGEST_OFFSET_DEG
    if difference_deg(named_deg, azimuth_deg) > limit_deg:
        yield Finding(
            "direction",
            Verdict.SUSPECT,
            f"about {describe_azimuth(named_deg)}, as the name says",
            describe_azimuth(azimuth_deg),
            "Likely cause: two cameras are swapped, or the ego axes are not x forward, y left, z up.",
            f"Correct camera_T_ego, or rename the camera. {COMPARE_PICTURES}",
        )


def swapped_findings(one: CheckedCalibration, other: CheckedCalibration) -> Iterator[tuple[str, Finding]]:
    """Yield a camera name and a finding for both of two cameras, if each fits the name of the other one better."""
    one_deg, other_deg = azimuth_from_name(one.name), azimuth_from_name(other.name)
    if one_deg is None or other_deg is None:
        return
    if not (one.has_reliable_direction and other.has_reliable_direction):
        return
    if "mirror" in f"{one.name} {other.name}".lower():
        return  # the name of a camera in a wing mirror says where it is, not where it looks
    gains_deg = [_swap_gain_deg(one_deg, one, other), _swap_gain_deg(other_deg, other, one)]
    if min(gains_deg) <= 0 or sum(gains_deg) <= LEAST_SWAP_GAIN_DEG:
        return
    for camera, partner in ((one, other), (other, one)):
        yield (
            camera.name,
            Finding(
                f"{COMPARED_DIRECTION} {partner.name}",
                Verdict.SUSPECT,
                f"a direction that fits the name {camera.name}",
                f"{describe_azimuth(camera.pose.azimuth_deg)}, which fits the name {partner.name} better, while "
                f"{partner.name} fits the name {camera.name} better",
                "Likely cause: the two cameras are swapped.",
                f"Swap the calibrations or the images of the two cameras. {COMPARE_PICTURES}",
            ),
        )


def _swap_gain_deg(named_deg: float, camera: CheckedCalibration, partner: CheckedCalibration) -> float:
    """By how much [deg] the partner's direction is nearer to the direction in a camera's name than the camera's own."""
    offset_deg = difference_deg(named_deg, camera.pose.azimuth_deg)
    return offset_deg - difference_deg(named_deg, partner.pose.azimuth_deg)
