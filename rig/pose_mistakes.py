"""Common mistakes in ego poses, and the likely causes of impossible speeds, turns and directions of motion."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..runtime.geometry import inverse, quaternion_from_rotation, rigid_transform, rotation_from_quaternion, rotation_z
from .motion_steps import MotionStep, median_slip_deg

Array = NDArray[np.float64]

EXPLAINED_SLIP_DEG = 10.0  # a mistake explains the slip if undoing it leaves less than this
SIMILAR_SLIP_DEG = 1.5  # two mistakes are named if they explain the slip about equally well
USUAL_SPEED_M_S = 8.0
SLOWEST_M_S, FASTEST_M_S = 0.5, 50.0
SIMILAR_SPEED = np.exp(0.5)  # two units are named if their speeds fit about equally well
METRES_PER_UNIT = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254}
METRES_PER_LARGE_UNIT = {"degrees of latitude and longitude": 111_320.0, "kilometres": 1000.0}
LARGEST_DEGREES = 180.0
LEAST_STEPS = 3  # to find the course and the headings related
LARGEST_OFFSET_RAD = 0.45  # a course is right to half a degree, which is 0.5 if degrees are read as radians
LEAST_RESULTANT = 0.8  # mean length of the sum of unit vectors: 1 if all angles are equal
SMALLEST_MISREAD_RAD = np.radians(np.pi)

INVERTED = "global_T_ego is inverted: the matrix is ego_T_global"
OTHER_AXES = "the ego frame has y forward instead of x, or its heading is measured from another axis"
BACKWARD_TURN = "the headings increase to the right instead of to the left"
QUATERNION_ORDER = "the quaternions were read in the wrong order, w x y z instead of x y z w or the reverse"
RADIANS_AS_DEGREES = "headings in radians were read as degrees"
DEGREES_AS_RADIANS = "headings in degrees were read as radians"


def slip_cause(steps: Sequence[MotionStep]) -> str:
    """The likely cause of motion across the heading, as a sentence."""
    slips_deg = {
        cause: round(min(median_slip_deg(steps, correct) for correct in corrections), 1)
        for cause, corrections in SLIP_MISTAKES.items()
    }
    largest_deg = min(EXPLAINED_SLIP_DEG, min(slips_deg.values()) + SIMILAR_SLIP_DEG)
    causes = sorted(
        (cause for cause in slips_deg if slips_deg[cause] <= largest_deg), key=lambda cause: slips_deg[cause]
    )
    # A wrong quaternion order explains many slips by chance.
    causes = [cause for cause in causes if cause != QUATERNION_ORDER] or causes
    if is_degrees_as_radians(steps):
        causes = [DEGREES_AS_RADIANS, *causes]
    elif not causes:
        causes = ["the headings in the poses are wrong"]
    return _sentence(causes[:2])


def speed_cause(steps: Sequence[MotionStep]) -> str:
    """The likely cause of impossible speeds, as a sentence."""
    displacements = [step.displacement_m() for step in steps]
    if _median_m([step.displacement_m(inverse) for step in steps]) < _median_m(displacements) / 10:
        return _sentence([INVERTED])
    speed = float(np.median([step.speed_m_s for step in steps]))
    speeds = {unit: speed * metres for unit, metres in METRES_PER_UNIT.items()}
    fits = {unit: abs(np.log(each / USUAL_SPEED_M_S)) for unit, each in speeds.items() if _is_usual(each)}
    if not fits:
        return _sentence(["the positions are not in metres, or the times are not in seconds"])
    best = min(fits.values())
    units = [unit for unit in sorted(fits, key=lambda unit: fits[unit]) if fits[unit] < best + np.log(SIMILAR_SPEED)]
    return _sentence([f"the positions are in {unit} instead of metres" for unit in units[:2]])


def turn_cause(steps: Sequence[MotionStep]) -> str:
    """The likely cause of impossible turns in most steps, as a sentence."""
    if is_degrees_as_radians(steps):
        return _sentence([DEGREES_AS_RADIANS])
    return _sentence(["headings in degrees were read as radians, or the headings flip"])


def large_unit(steps: Sequence[MotionStep]) -> str | None:
    """The unit, larger than a metre, in which the small steps are typical of a driving vehicle. None if no unit fits.

    The altitude may be in metres, so only x and y count.
    """
    positions = np.array([pose[:2, 3] for step in steps for pose in (step.before, step.after)])
    elapsed_s = np.array([step.elapsed_s for step in steps])
    moved = np.array([np.hypot(*(step.after[:2, 3] - step.before[:2, 3])) for step in steps])
    if not len(steps) or (elapsed_s <= 0).any() or not moved.all():
        return None
    for unit, metres in METRES_PER_LARGE_UNIT.items():
        is_possible = unit == "kilometres" or np.abs(positions).max() <= LARGEST_DEGREES
        if is_possible and _is_usual(float(np.median(moved / elapsed_s)) * metres):
            return unit
    return None


def is_degrees_as_radians(steps: Sequence[MotionStep]) -> bool:
    """Whether the headings are the course in degrees, taken as radians, and not the course itself."""
    if len(steps) < LEAST_STEPS:
        return False
    headings = np.array([step.heading_rad for step in steps])
    courses = np.unwrap([step.course_rad for step in steps])
    # On a curve, the headings turn 57 times as fast as the course. On a straight road, only the value is known.
    offsets = headings - np.degrees(courses)
    is_value = abs(np.angle(np.exp(1j * offsets).mean())) < LARGEST_OFFSET_RAD
    is_turn = _resultant(offsets) > _resultant(headings - courses) + 0.2
    return _resultant(offsets) > LEAST_RESULTANT and bool(is_value or is_turn)


def _resultant(angles_rad: Array) -> float:
    """The length of the mean of the unit vectors with these angles."""
    return float(np.abs(np.exp(1j * angles_rad).mean()))


def _is_usual(speed_m_s: float) -> bool:
    return SLOWEST_M_S <= speed_m_s <= FASTEST_M_S


def _median_m(displacements: Sequence[Array]) -> float:
    """The median length [m] of displacements (3,)."""
    return float(np.median(np.linalg.norm(displacements, axis=-1)))


def _sentence(causes: Sequence[str]) -> str:
    return f"Likely cause: {'; or '.join(causes)}."


def _with_quaternion_order(order: tuple[int, int, int, int]) -> Callable[[Array], Array]:
    def correct(pose: Array) -> Array:
        quaternion = quaternion_from_rotation(pose[:3, :3])[list(order)]
        return rigid_transform(rotation_from_quaternion(quaternion), pose[:3, 3])

    return correct


def _with_heading(change: Callable[[float], float]) -> Callable[[Array], Array]:
    def correct(pose: Array) -> Array:
        return rigid_transform(rotation_z(change(float(np.arctan2(pose[1, 0], pose[0, 0])))), pose[:3, 3])

    return correct


def _larger_heading(heading_rad: float) -> float:
    """The heading that was read as degrees; a quarter turn, which explains nothing, for a larger one."""
    return float(np.degrees(heading_rad)) if abs(heading_rad) <= SMALLEST_MISREAD_RAD else heading_rad


SLIP_MISTAKES: dict[str, list[Callable[[Array], Array]]] = {  # by cause: corrections of a pose
    INVERTED: [inverse],
    OTHER_AXES: [lambda pose: pose @ rigid_transform(rotation_z(np.pi / 2), np.zeros(3))],
    BACKWARD_TURN: [_with_heading(lambda heading: -heading)],
    RADIANS_AS_DEGREES: [_with_heading(_larger_heading)],
    QUATERNION_ORDER: [_with_quaternion_order((3, 0, 1, 2)), _with_quaternion_order((1, 2, 3, 0))],
}
