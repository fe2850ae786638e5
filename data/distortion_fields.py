"""Fields of lens distortion in a calibration. They are refused, because the cameras are pinhole cameras."""

import re
from typing import Any, Final

from pydantic_core import PydanticCustomError

from ..runtime.printable import printable, shortened

# By the names in OpenCV, ROS, Kalibr, COLMAP, KITTI, Waymo and nuPlan files, without underscores and in lower case.
# K without a number is the matrix of the intrinsics.
_COEFFICIENTS: Final = re.compile(
    r".*distort.*|.*fisheye.*|(cam)?dist|distcoeffs?|d|d\d+|k[1-9]|p[12]|s[1-4]|xi|(radial|tangential)(coeff(icient)?s)?"
)
_MODELS: Final = re.compile(r"(camera|lens|projection)?(model|type)")
_PINHOLE: Final = frozenset({"", "none", "pinhole", "perspective", "simplepinhole"})


def refuse_distortion(calibration: Any) -> Any:
    """Return a calibration unchanged. Raises an error of pydantic if it has a field of lens distortion."""
    if isinstance(calibration, dict):
        for name, value in calibration.items():
            if _is_distortion(name, value):
                raise _distortion_error(name, value)
    return calibration


def _is_distortion(name: str, value: Any) -> bool:
    plain = _plain(name)
    is_model = bool(_MODELS.fullmatch(plain)) and isinstance(value, str) and _plain(value) not in _PINHOLE
    return is_model or bool(_COEFFICIENTS.fullmatch(plain))


def _distortion_error(name: str, value: Any) -> PydanticCustomError:
    text = "expected images without lens distortion; got {name}={value}. {remedy}"
    is_zero = not value or (isinstance(value, list) and all(coefficient == 0 for coefficient in value))
    remedy = (
        "The images have no distortion, so remove the field"
        if is_zero
        else "Rectify the images with the old matrix and the coefficients (cv2.initUndistortRectifyMap and cv2.remap), "
        "give the new matrix (of cv2.getOptimalNewCameraMatrix) as intrinsics_px, and remove the field. "
        "docs/scene-folder.md has an example"
    )
    return PydanticCustomError(
        "distortion", text, {"name": printable(name), "value": shortened(value), "remedy": remedy}
    )


def _plain(text: str) -> str:
    return re.sub(r"[\W_]", "", text).lower()
