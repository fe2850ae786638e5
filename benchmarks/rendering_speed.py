"""The time of rendering one synthetic frame, in milliseconds and relative to fixed work on the same six images.

    python -m benchmarks.rendering_speed [FRAMES]

The fixed work is to resize the images to twice their size and to encode them as JPEG. The two alternate, so that other
load on the machine slows both alike. Each is measured in CPU time of one thread.
"""

import statistics
import sys
import time
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from duospacenet.runtime.cpu import describe_cpu
from duospacenet.synthetic.drive import SyntheticDrive

SEED = 7
NUM_FRAMES = 32


def main() -> None:
    num_frames = int(sys.argv[1]) if len(sys.argv) > 1 else NUM_FRAMES
    cv2.setNumThreads(1)
    drive = SyntheticDrive(SEED, frames=num_frames)
    list(drive)  # generates every block of the world, which is cached
    rendering_s, reference_s = [], []
    for index in range(num_frames):
        start_s = time.thread_time()
        frame = drive.frame(index)
        middle_s = time.thread_time()
        resize_and_encode(image for image in frame.images.values() if image is not None)
        rendering_s.append(middle_s - start_s)
        reference_s.append(time.thread_time() - middle_s)
    ratio = statistics.median(a / b for a, b in zip(rendering_s, reference_s, strict=True))
    print(f"CPU: {describe_cpu()}")
    print(f"rendering: {1000 * statistics.median(rendering_s):.1f} ms per frame of six images of 400x160")
    print(f"reference: {1000 * statistics.median(reference_s):.1f} ms per frame; ratio: {ratio:.2f}")


def resize_and_encode(images: Iterable[NDArray[np.uint8]]) -> None:
    """The fixed work that rendering is compared with."""
    for image in images:
        larger = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
        cv2.imencode(".jpg", larger, [cv2.IMWRITE_JPEG_QUALITY, 95])


if __name__ == "__main__":
    main()
