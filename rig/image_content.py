"""Images that cannot be right by themselves or together: without content, or the same in two cameras."""

from collections.abc import Mapping
from itertools import combinations

from .findings import Finding, Verdict
from .thumbnails import Thumbnail, is_same_image

LEAST_FLAT_FRAMES = 3  # in a row; a tunnel's end or a flash may hide the content of fewer
LEAST_SIMILAR_FRAMES = 3  # for images of two cameras that are similar, but not exact copies

MARK_AS_LOST = "If the camera is lost, set its image to null."
COMPARE_PATHS = "Compare the paths of the two cameras' images."


class FlatImages:
    """Finds cameras whose images have no content. Keeps two counts per camera."""

    def __init__(self) -> None:
        self._in_a_row: dict[str, int] = {}
        self._found: dict[str, tuple[int, int]] = {}  # by camera, first frame and number of frames

    def add(self, index: int, thumbnails: Mapping[str, Thumbnail]) -> None:
        """Add the next frame. thumbnails: of its images, by camera; without lost cameras."""
        for name, thumbnail in thumbnails.items():
            self._in_a_row[name] = in_a_row = self._in_a_row.get(name, 0) + 1 if thumbnail.is_flat else 0
            if name in self._found and in_a_row:
                first, num_frames = self._found[name]
                self._found[name] = first, num_frames + 1
            elif in_a_row >= LEAST_FLAT_FRAMES:
                self._found[name] = index - in_a_row + 1, in_a_row

    def camera_findings(self) -> list[tuple[str, Finding]]:
        """Camera and finding for each camera with such images."""
        return [(name, self._finding(*found)) for name, found in self._found.items()]

    def _finding(self, first: int, num_frames: int) -> Finding:
        return Finding(
            "image content",
            Verdict.SUSPECT,
            "an image with content",
            f"one shade in {num_frames} frames, from frame {first} on",
            "Likely cause: a lost camera was given as a black image, the camera is covered, or it is a dark night.",
            MARK_AS_LOST,
            first,
            num_frames,
        )


class TwinImages:
    """Finds pairs of cameras that have the same image in one frame. Keeps two numbers per pair."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], tuple[int, int]] = {}  # first frame and number of frames
        self._exact: set[tuple[str, str]] = set()

    def add(self, index: int, thumbnails: Mapping[str, Thumbnail]) -> None:
        """Add the next frame. thumbnails: of its images, by camera; without lost cameras."""
        for pair in combinations(thumbnails, 2):
            one, other = thumbnails[pair[0]], thumbnails[pair[1]]
            if is_same_image(one, other):
                first, num_frames = self._found.get(pair, (index, 0))
                self._found[pair] = first, num_frames + 1
                if one.digest == other.digest:
                    self._exact.add(pair)

    def camera_findings(self) -> list[tuple[str, Finding]]:
        """The second camera of each pair, and a finding that names the first."""
        return [
            (pair[1], self._finding(pair[0], *found))
            for pair, found in self._found.items()
            if pair in self._exact or found[1] >= LEAST_SIMILAR_FRAMES
        ]

    def _finding(self, partner: str, first: int, num_frames: int) -> Finding:
        return Finding(
            f"image compared with {partner}",
            Verdict.SUSPECT,
            "a different image",
            f"the image of {partner} in {num_frames} frames, from frame {first} on",
            "Likely cause: one image is given under both names.",
            COMPARE_PATHS,
            first,
            num_frames,
        )
