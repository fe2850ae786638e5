"""Pictures, videos and recordings of frames.

One run: `frame_picture.py` (boxes in the camera images, beside a bird's-eye view), `video.py`.
Several results: `comparison_picture.py`. Features: `heatmap_picture.py`.
Recordings for viewers: `recorded_frame.py` (their content), `foxglove_recording.py`, `rerun_recording.py`.
"""

from .frame_picture import draw_frame
from .video import VideoWriter

__all__ = ["VideoWriter", "draw_frame"]
