"""Stale input: images, poses or times that do not belong to their frames, found while the frames pass by.

The causes in the findings are likely, not certain.
"""

from dataclasses import replace

from ..runtime.frame import Frame
from ..runtime.history import ResetLimits
from .constant_pose import ConstantPose
from .findings import Finding
from .frozen_images import FrozenImages
from .history_resets import HistoryResets
from .image_content import FlatImages, TwinImages
from .thumbnails import make_thumbnail


class StaleInput:
    """Checks frames that come in order. Its memory does not grow with the number of frames.

    It takes about 0.2 ms per image.
    """

    def __init__(self, limits: ResetLimits) -> None:
        """limits: those of the bundle's temporal window, or of the requirements on a rig."""
        self._frozen, self._flat, self._twins = FrozenImages(), FlatImages(), TwinImages()
        self._pose, self._resets = ConstantPose(), HistoryResets(limits)

    def add(self, index: int, frame: Frame) -> None:
        """Add the next frame. Its time and pose must be valid. An image that is None is not compared."""
        thumbnails = {name: make_thumbnail(image) for name, image in frame.images.items() if image is not None}
        header = replace(frame, images={}, ground_truth=None)  # it is kept; the images must not be
        self._frozen.add(index, header, thumbnails)
        self._flat.add(index, thumbnails)
        self._twins.add(index, thumbnails)
        self._pose.add(index, header, thumbnails)
        self._resets.add(index, header)

    def camera_findings(self) -> list[tuple[str, Finding]]:
        """Cameras and findings about their images: frozen, without content, or the same as another camera's."""
        return [*self._frozen.camera_findings(), *self._flat.camera_findings(), *self._twins.camera_findings()]

    def drive_findings(self, is_complete: bool = True) -> list[Finding]:
        """Findings about all cameras together, about poses, and about resets of the history.

        is_complete: whether the last frame has been added. Some findings need all frames.
        """
        resets = self._resets.drive_findings() if is_complete else []
        return [*self._frozen.drive_findings(), *self._pose.drive_findings(is_complete), *resets]
