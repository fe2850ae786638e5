"""Pictures and videos of frames: boxes in the camera images, beside a bird's-eye view."""

from .frame_picture import draw_frame
from .video import VideoWriter

__all__ = ["VideoWriter", "draw_frame"]
