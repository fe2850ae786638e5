"""A catalogue of mistakes in scene folders, each with the diagnosis that `check-rig` must give.

Angles, cameras and amounts come from a random generator, so that no check fits a single value.
"""

from tests.rig.box_mistakes import BOX_MISTAKES
from tests.rig.calibration_mistakes import CALIBRATION_MISTAKES
from tests.rig.drive_mistakes import DRIVE_MISTAKES
from tests.rig.image_mistakes import IMAGE_MISTAKES
from tests.rig.scene_mistake import Mistake

MISTAKES: dict[str, Mistake] = {**CALIBRATION_MISTAKES, **IMAGE_MISTAKES, **DRIVE_MISTAKES, **BOX_MISTAKES}
