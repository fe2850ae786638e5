"""Frames with lost cameras: the policies for them, and the decision to skip a frame."""

from typing import Literal, get_args

from .errors import InputError, UsageError
from .frame import Frame

MissingCameraPolicy = Literal["blank", "skip", "error"]


def check_missing_camera_policy(value: str) -> MissingCameraPolicy:
    """Return `value` as a policy. Raises UsageError for an unknown one.

    blank: mask the lost cameras and use the others.
    skip: skip the frame; the history does not change.
    error: raise an InputError.
    """
    for policy in get_args(MissingCameraPolicy):
        if value == policy:
            return policy
    *names, last = get_args(MissingCameraPolicy)
    raise UsageError(f"on_missing: expected {', '.join(names)} or {last}; got {value!r}.")


def skip_reason(frame: Frame, policy: MissingCameraPolicy) -> str | None:
    """Return why a valid frame is skipped, or None if it is processed.

    A frame without any image is skipped under "blank" too.
    Raises InputError if a camera is lost and the policy is "error".
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
