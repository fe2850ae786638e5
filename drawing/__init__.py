"""Pictures of frames: the cameras with boxes in them, beside the bird's-eye view."""

from .frame_picture import draw_frame
from .video import VideoWriter

__all__ = ["VideoWriter", "draw_frame"]
