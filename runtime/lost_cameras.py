"""What a stream does with a frame that misses some of its pictures."""

from typing import Literal, get_args

from .errors import InputError, UsageError
from .frame import Frame

MissingCameraPolicy = Literal["blank", "skip", "error"]


def check_missing_camera_policy(value: str) -> MissingCameraPolicy:
    """Raises UsageError for what is no policy.

    blank: a lost camera is masked and the others are looked at. skip: the frame is left out, and the history is as if
    it had never come. error: it is refused.
    """
    for policy in get_args(MissingCameraPolicy):
        if value == policy:
            return policy
    raise UsageError(f"on_missing: expected {', '.join(get_args(MissingCameraPolicy))}; got {value!r}.")


def skip_reason(frame: Frame, policy: MissingCameraPolicy) -> str | None:
    """Why a checked frame is left out, or None where it is looked at. A frame without any picture always is left out.

    Raises InputError where a camera is lost and the policy is "error".
    """
    lost = [name for name, image in frame.images.items() if image is None]
    if lost and policy == "error":
        raise InputError(
            f"camera {lost[0]}: expected an image; got a lost camera, at {frame.timestamp_s!r} s. "
            "Leave the frame out, or choose on_missing 'blank' or 'skip'."
        )
    if len(lost) == len(frame.cameras):
        return "every camera is lost"
    if lost and policy == "skip":
        return f"lost: {', '.join(lost)}"
    return None
