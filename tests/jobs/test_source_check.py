"""The check of a whole source: every frame is checked, equal calibrations only once."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.jobs import source_check
from duospacenet.jobs.input_warnings import InputWarnings
from duospacenet.jobs.source_check import check_source
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.frame import Frame
from duospacenet.runtime.geometry import rigid_transform
from duospacenet.synthetic.nuscenes_rig import build_rig
from tests.helpers.streams import TINY_SIZE_PX, with_camera

CAMERAS = build_rig(5, TINY_SIZE_PX)


class Frames:
    """A source of frames without images."""

    def __init__(self, frames: list[Frame], lost: dict[int, tuple[str, ...]] | None = None) -> None:
        self._frames, self._lost = frames, lost or {}
        self.num_read = 0

    def __len__(self) -> int:
        return len(self._frames)

    def frame_without_images(self, index: int) -> Frame:
        self.num_read += 1
        return self._frames[index]

    def check_image_files(self, index: int) -> tuple[str, ...]:
        return self._lost.get(index, ())


def drive(num_frames: int = 40) -> list[Frame]:
    return [
        Frame(dict.fromkeys(CAMERAS), CAMERAS, rigid_transform(np.eye(3), [3.0 * index, 0, 0]), 0.5 * index, "scene")
        for index in range(num_frames)
    ]


def check(pipeline, frames: list[Frame], **options) -> list[str]:
    warnings = InputWarnings()
    check_source(Frames(frames, options.pop("lost", None)), pipeline.manifest, warnings, **options)
    return warnings.texts


def test_a_correct_drive_has_no_warnings(pipeline):
    assert check(pipeline, drive()) == []
    assert check(pipeline, drive(1)) == []


def test_lost_images_are_counted_in_one_warning(pipeline):
    lost = {3: ("CAM_BACK",), 4: ("CAM_BACK", "CAM_FRONT")}
    assert check(pipeline, drive(), lost=lost) == [
        "frame 3, drive: images: expected an image of every camera; got 3 of 240 images lost (CAM_BACK: 2, "
        "CAM_FRONT: 1). Their files are missing, or the source names no file for them."
    ]


BAD = {
    "a pose": (lambda frame: replace(frame, global_T_ego=np.diag([-1.0, 1, 1, 1])), "frame 37: global_T_ego: "),
    "a time": (lambda frame: replace(frame, timestamp_s=18.0), "frame 37: timestamp_s: expected later than 18.0"),
    "a camera": (
        lambda frame: with_camera(frame, "CAM_BACK", camera_T_ego=np.diag([1.0, 1, -1, 1])),
        "frame 37: camera CAM_BACK: camera_T_ego: ",
    ),
    "a camera in millimetres": (
        lambda frame: with_camera(frame, "CAM_BACK", camera_T_ego=millimetres(CAMERAS["CAM_BACK"].camera_T_ego)),
        "frame 37: camera CAM_BACK: pose: ",
    ),
    "a seventh camera": (
        lambda frame: replace(
            frame,
            cameras=CAMERAS | {"SEVENTH": CAMERAS["CAM_BACK"]},
            images=dict.fromkeys([*CAMERAS, "SEVENTH"]),
        ),
        "frame 37: cameras: expected 1 to 6",
    ),
}


def millimetres(camera_T_ego: np.ndarray) -> np.ndarray:
    return rigid_transform(camera_T_ego[:3, :3], 1000 * camera_T_ego[:3, 3])


@pytest.mark.parametrize("kind", BAD)
def test_one_bad_frame_is_found_wherever_it_is(pipeline, kind):
    change, words = BAD[kind]
    frames = drive()
    frames[37] = change(frames[37])
    with pytest.raises(InputError) as refused:
        check(pipeline, frames)
    assert str(refused.value).startswith(words)
    assert check(pipeline, frames, num_frames=37) == []


def test_a_broken_calibration_may_be_accepted_with_a_warning(pipeline):
    frames = drive(3)
    frames[1] = BAD["a camera in millimetres"][0](frames[1])
    with pytest.raises(InputError, match="Add --no-check if"):
        check(pipeline, frames)
    warnings = check(pipeline, frames, refuse_broken=False)
    assert any("frame 1, camera CAM_BACK: pose: " in text for text in warnings)
    with pytest.raises(InputError, match="camera_T_ego"):  # a matrix that is not a pose is never accepted
        check(pipeline, [BAD["a camera"][0](frames[0])], refuse_broken=False)


def test_equal_calibrations_are_judged_once(pipeline, monkeypatch):
    judged = []
    judge_calibration = source_check.judge_calibration
    monkeypatch.setattr(
        source_check, "judge_calibration", lambda cameras: judged.append(cameras) or judge_calibration(cameras)
    )
    frames = drive(9)
    moved = rigid_transform(np.eye(3), [0, 0, 1e-6]) @ CAMERAS["CAM_BACK"].camera_T_ego
    frames[4] = with_camera(frames[4], "CAM_BACK", camera_T_ego=moved)
    check(pipeline, frames)
    assert len(judged) == 2


def test_a_dropped_history_has_one_cause(pipeline):
    """The cause is named by the finding about times, if there is one."""
    slow = check(pipeline, [replace(frame, timestamp_s=1.5e9 + 6 * frame.timestamp_s) for frame in drive(9)])
    assert [text.split(": ")[1] for text in slow] == ["time between frames", "history"]
    assert "Likely cause: the rig takes few frames" in slow[0]
    assert slow[1].endswith("dropped at 8 of 8 frames after the first: gap of 3.00 s, above 2 s.")
    [scenes] = check(pipeline, [replace(frame, scene=str(index)) for index, frame in enumerate(drive(9))])
    assert "Likely cause: `scene` holds a name of the frame instead of the drive." in scenes


@pytest.mark.parametrize("policy", ["blank", "skip"])
def test_lost_cameras_are_only_refused_by_the_policy_error(pipeline, policy):
    lost = {5: ("CAM_BACK",)}
    assert len(check(pipeline, drive(), lost=lost, on_missing=policy)) == 1  # a warning
    with pytest.raises(InputError, match="frame 5: camera CAM_BACK: expected an image, because of --on-missing error"):
        check(pipeline, drive(), lost=lost, on_missing="error")


def test_progress_is_only_shown_for_long_sources(pipeline, monkeypatch):
    shown = []

    def progress(items, description, total=None):
        shown.append(description)
        return iter(items)

    check(pipeline, drive(5), progress=progress)
    assert shown == []
    monkeypatch.setattr(source_check, "LONG_SOURCE", 4)
    check(pipeline, drive(5), progress=progress)
    assert shown == ["check"]
