"""Directions of cameras and poses that do not fit the images: exchanged images, turned cameras, turned poses."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations

import numpy as np

from .constant_pose import GIVE_POSES, SAME_POSE_CAUSE
from .findings import Finding, NotJudged, Verdict
from .image_motion import ImageMotion
from .image_overlaps import ImageOverlaps

YAWS_DEG = np.arange(-90, 92.5, 2.5)  # of a turned camera
ALL_YAWS_DEG = np.arange(-165, 181, 15)  # of turned poses
PEAK_DEG = 8.0
SMALLEST_YAW_DEG = 10.0  # near things look turned by less, seen from the two ends of a long vehicle
LEAST_JUDGED = 10  # matches with other cameras that agree with the calibration
LEAST_JUDGED_MOTION = 20  # matches between frames that agree with the calibration

# Evidence against a calibration: matches that agree with another one, and how many more than with the given one.
LEAST_MATCHES = 15
LEAST_RATIO = 3.0
LEAST_MOTION_MATCHES = 40  # moving objects agree with wrong motions too, so more matches are needed
LEAST_MOTION_RATIO = 2.0
LEAST_MOVING = 150  # matches of all cameras together, before the poses are doubted
LEAST_MOVING_AT_REST = 80  # matches between frames with the same pose, before the pose is doubted
LEAST_MOVING_SHARE = 0.6  # of the matches between frames with the same pose: traffic moves past a parked vehicle
LEAST_FITTING_SHARE = 0.2  # of them; 0.5 to 0.8 fit right poses

COMPARE = "Compare the cameras' pictures with the ground grid."
GIVE_OWN_IMAGES = "Correct the paths of the images, or the calibrations of the two cameras."
CORRECT_POSES = (
    "Correct global_T_ego: it maps points of the ego frame (x forward, y left, z up) to the global frame, at the time "
    "of the images."
)


class ImageDirections:
    """Compares the directions of the cameras with their images.

    cameras: names of the cameras whose calibrations have no other finding.
    """

    def __init__(self, overlaps: ImageOverlaps, motion: ImageMotion, cameras: Iterable[str]) -> None:
        self._overlaps, self._motion = overlaps, motion
        self._cameras = list(cameras)
        self._wrong: set[str] = set()

    def camera_findings(self) -> Iterator[tuple[str, Finding]]:
        """Yield cameras and findings: exchanged images first, then turned cameras."""
        yield from self._exchanged()
        yield from self._turned_by_overlap()
        yield from self._turned_by_motion()

    def drive_findings(self) -> list[Finding]:
        """A finding if the images of all cameras together do not fit the motion in the poses.

        Details that move between frames with the same pose also show a constant pose if too little of each image
        changes for `ConstantPose`.
        """
        at_rest, moving = self._motion.at_rest
        if moving >= LEAST_MOVING_AT_REST and moving > LEAST_MOVING_SHARE * (at_rest + moving):
            return [_constant_pose_finding(moving, at_rest + moving)]
        given = self._total(0.0)
        yaws = {yaw_deg: self._total(yaw_deg)[0] for yaw_deg in ALL_YAWS_DEG.tolist()}
        best_deg = max(yaws, key=lambda yaw_deg: yaws[yaw_deg])
        if _is_better(yaws[best_deg], given[0], 1.5 * LEAST_MOTION_MATCHES, LEAST_RATIO) and abs(best_deg) > 20:
            return [_turned_poses_finding(best_deg, yaws[best_deg], given[0])]
        if given[1] >= LEAST_MOVING and max(given[0], yaws[best_deg]) < LEAST_FITTING_SHARE * given[1]:
            return [_unrelated_poses_finding(*given)]
        return []

    def not_judged(self) -> list[NotJudged]:
        """The cameras whose direction could not be compared, with the reason."""
        thin = [
            name
            for name in self._cameras
            if name not in self._wrong
            and self._overlaps.num_agreeing([name]) < LEAST_JUDGED
            and self._motion.count(name).agreeing < LEAST_JUDGED_MOTION
        ]
        if not thin:
            return []
        moves = "" if self._motion.cameras else ", and the vehicle does not move between the compared frames"
        reason = f"too few details in the images that fit those of other cameras or frames{moves}"
        return [NotJudged("directions compared with the images", reason, tuple(thin))]

    def _exchanged(self) -> Iterator[tuple[str, Finding]]:
        """Yield a finding for both cameras of each pair whose images fit the calibration of the other one.

        The strongest pair comes first. It is corrected before the next one is looked for: the wrong calibrations
        would also fit another exchange, of two neighbours.
        """
        while True:
            evidence = {pair: self._exchange_evidence(pair) for pair in combinations(self._right(), 2)}
            pair = max(evidence, key=lambda pair: evidence[pair], default=None)
            if pair is None or not evidence[pair]:
                return
            self._wrong |= set(pair)
            self._overlaps = self._overlaps.exchanged(pair)
            for name, partner in (pair, pair[::-1]):
                yield name, _exchanged_finding(partner, evidence[pair])

    def _exchange_evidence(self, pair: tuple[str, str]) -> int:
        """The number of matches that speak for an exchange; 0 if they are too few."""
        motion = self._motion
        exchanged = self._overlaps.exchanged(pair).num_agreeing(pair)
        given = self._overlaps.num_agreeing(pair)
        if _is_better(exchanged, given, LEAST_MATCHES, LEAST_RATIO):
            return exchanged
        one, other = pair
        moving = motion.count(one, calibration_of=other).agreeing + motion.count(other, calibration_of=one).agreeing
        given_moving = motion.count(one).agreeing + motion.count(other).agreeing
        is_moving = _is_better(moving, given_moving, LEAST_MOTION_MATCHES, LEAST_RATIO)
        return moving if is_moving and given < LEAST_MATCHES else 0

    def _turned_by_overlap(self) -> Iterator[tuple[str, Finding]]:
        """Yield a finding for the camera that turning brings to the best agreement with the others, again and again."""
        while True:
            gains = {name: gain for name in self._cameras if (gain := self._turn_gain(name))}
            if not gains:
                return
            name = max(gains, key=lambda name: gains[name][0] + self._motion_gain(name, gains[name][1]))
            num_more, yaw_deg = gains[name]
            self._wrong.add(name)
            rivals = [
                other
                for other in gains
                if other != name and gains[other][0] > 0.8 * num_more and not self._motion_gain(name, yaw_deg)
            ]
            yield name, _turned_finding(yaw_deg, f"{num_more} more matches with the images of other cameras", rivals)
            self._wrong |= set(rivals)

    def _turn_gain(self, name: str) -> tuple[int, float] | None:
        """How many more matches agree after turning a camera, and the angle [deg]; None if too few do."""
        partners = [partner for partner in self._overlaps.partners(name) if partner in self._right()]
        if name not in self._right():
            return None
        counts = [
            sum(self._overlaps.num_agreeing_pair((partner, name), yaw_deg) for partner in partners)
            for yaw_deg in YAWS_DEG.tolist()
        ]
        most, given, yaw_deg = max(counts), counts[len(YAWS_DEG) // 2], _peak_deg(counts)
        if abs(yaw_deg) < SMALLEST_YAW_DEG or not _is_better(most, given, LEAST_MATCHES, LEAST_RATIO):
            return None
        return most - given, yaw_deg

    def _motion_gain(self, name: str, yaw_deg: float) -> int:
        """How many more matches agree with the motion after turning a camera; 0 if they are too few."""
        gain = self._motion.count(name, yaw_deg).agreeing - self._motion.count(name).agreeing
        return gain if gain >= LEAST_MATCHES else 0

    def _turned_by_motion(self) -> Iterator[tuple[str, Finding]]:
        """Yield a finding for each camera without overlaps whose images move as if it were turned."""
        for name in self._right():
            if self._overlaps.num_agreeing([name]) >= LEAST_JUDGED:
                continue
            counts = [self._motion.count(name, yaw_deg).agreeing for yaw_deg in YAWS_DEG.tolist()]
            most, given, yaw_deg = max(counts), counts[len(YAWS_DEG) // 2], _peak_deg(counts)
            is_better = _is_better(most, given, LEAST_MOTION_MATCHES, LEAST_MOTION_RATIO)
            if is_better and abs(yaw_deg) >= 2 * SMALLEST_YAW_DEG:
                self._wrong.add(name)
                evidence = f"{most} instead of {given} matches between frames that fit the motion"
                yield name, _turned_finding(yaw_deg, evidence, [])

    def _right(self) -> list[str]:
        return [name for name in self._cameras if name not in self._wrong]

    def _total(self, yaw_deg: float) -> tuple[int, int]:
        """The numbers of agreeing and of moving matches of all cameras, for all cameras turned together."""
        counts = [self._motion.count(name, yaw_deg) for name in self._right()]
        return sum(count.agreeing for count in counts), sum(count.moving for count in counts)


def _peak_deg(counts: Sequence[int]) -> float:
    """The angle [deg] with the largest count: the mean of about equal ones beside each other."""
    best_deg = YAWS_DEG[int(np.argmax(counts))]
    is_peak = (np.array(counts) >= 0.9 * max(counts)) & (np.abs(YAWS_DEG - best_deg) <= PEAK_DEG)
    return float(YAWS_DEG[is_peak].mean())


def _is_better(count: int, given: int, least: float, ratio: float) -> bool:
    return count >= least and count >= ratio * given + least / 2


def _exchanged_finding(partner: str, num_matches: int) -> Finding:
    return Finding(
        f"image compared with {partner}",
        Verdict.SUSPECT,
        "an image that fits the calibration",
        f"images that fit the calibration of {partner}, by {num_matches} matching details",
        f"Likely cause: the images of this camera and of {partner} are exchanged, or their calibrations.",
        GIVE_OWN_IMAGES,
    )


def _turned_finding(yaw_deg: float, evidence: str, rivals: list[str]) -> Finding:
    side = "left" if yaw_deg > 0 else "right"
    others = f" Or the azimuth of {', '.join(rivals)} is wrong." if rivals else ""
    return Finding(
        "direction in the images",
        Verdict.SUSPECT,
        "a direction that fits the images",
        f"images that fit a camera about {abs(yaw_deg):.0f} degrees more to the {side}, with {evidence}",
        f"Likely cause: the azimuth in camera_T_ego is wrong by about {abs(yaw_deg):.0f} degrees, or the camera was "
        f"turned after the calibration.{others}",
        f"Correct camera_T_ego. {COMPARE}",
    )


def _turned_poses_finding(yaw_deg: float, num_matches: int, num_given: int) -> Finding:
    side = "left" if yaw_deg > 0 else "right"
    cause = "the ego axes of the calibrations and of the poses differ, or the headings are measured from another axis"
    if abs(yaw_deg) > 150:
        cause = "global_T_ego is inverted or its headings are reversed, or the images are in reverse order"
    return Finding(
        "motion in the images",
        Verdict.SUSPECT,
        "images that move as the poses say",
        f"images that fit a vehicle with all cameras turned by {abs(yaw_deg):.0f} degrees to the {side}, with "
        f"{num_matches} instead of {num_given} matching details",
        f"Likely cause: {cause}.",
        CORRECT_POSES,
    )


def _constant_pose_finding(num_moving: int, num_matches: int) -> Finding:
    return Finding(
        "ego pose",
        Verdict.SUSPECT,
        "poses that change as the images do",
        f"the same pose in frames between which {num_moving} of {num_matches} matching details move",
        SAME_POSE_CAUSE,
        GIVE_POSES,
    )


def _unrelated_poses_finding(num_agreeing: int, num_moving: int) -> Finding:
    return Finding(
        "motion in the images",
        Verdict.SUSPECT,
        "images that move as the poses say",
        f"{num_agreeing} of {num_moving} moving details that fit the poses",
        "Likely cause: the poses belong to other frames or to another recording, or their rotations are wrong.",
        CORRECT_POSES,
    )
