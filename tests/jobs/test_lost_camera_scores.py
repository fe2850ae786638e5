"""Scores with lost cameras: which cameras are lost, and the loop over their number."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from duospacenet import jobs
from duospacenet.jobs.lost_camera_scores import CameraLoser, LostCameraScore, fewest_cameras, lost_cameras
from duospacenet.runtime import Pipeline
from duospacenet.runtime.errors import InputError
from tests.helpers.pictures import surround_frame


class Recorder:
    """A detector that records which cameras of its frames have an image."""

    def __init__(self):
        self.present, self.resets = [], 0

    def reset(self):
        self.resets += 1

    def step(self, frame):
        self.present.append([name for name, image in frame.images.items() if image is not None])


def lost_sets(num_lost, num_frames=300, frame=None, seed=0):
    frame = surround_frame() if frame is None else frame
    recorder = Recorder()
    loser = CameraLoser(recorder, num_lost, seed)
    for _ in range(num_frames):
        loser.step(frame)
    return [set(frame.cameras) - set(present) for present in recorder.present]


@pytest.mark.parametrize("num_lost", range(6))
def test_every_frame_loses_as_many_distinct_cameras(num_lost):
    assert {len(lost) for lost in lost_sets(num_lost)} == {num_lost}


def test_all_cameras_are_lost_equally_often():
    """Of 300 frames each of six cameras is lost in about 50 * k, with a standard deviation of at most 8.7."""
    for num_lost in (1, 3, 5):
        counts = [sum(name in lost for lost in lost_sets(num_lost)) for name in surround_frame().cameras]
        assert all(abs(count - 50 * num_lost) < 40 for count in counts)
    assert len({frozenset(lost) for lost in lost_sets(3)}) == 20  # all subsets of three


def test_more_lost_cameras_include_those_of_fewer():
    for fewer, more in pairwise(lost_sets(number) for number in range(6)):
        assert all(one < other for one, other in zip(fewer, more, strict=True))


def test_the_choice_is_the_same_again_and_differs_between_frames_and_seeds():
    assert lost_sets(2) == lost_sets(2) != lost_sets(2, seed=1)
    assert len({frozenset(lost) for lost in lost_sets(2, 10)}) > 1


def test_cameras_that_are_lost_already_are_not_chosen_again():
    frame = surround_frame(lost=["CAM_FRONT", "CAM_BACK"])
    assert all({"CAM_FRONT", "CAM_BACK"} < lost and len(lost) == 5 for lost in lost_sets(3, 20, frame))
    assert len(lost_cameras(frame, 5, np.random.default_rng(0))) == 4


def test_the_frame_itself_keeps_its_images_and_a_reset_is_passed_on():
    frame, recorder = surround_frame(), Recorder()
    loser = CameraLoser(recorder, 2)
    loser.reset()
    loser.step(frame)
    assert recorder.resets == 1
    assert all(image is not None for image in frame.images.values())


def test_the_scores_are_those_of_evaluations_with_fewer_cameras(tiny_bundle, monkeypatch):
    """With zero lost cameras they are those of the report. Five more evaluations run for six cameras."""
    frames = []
    step = CameraLoser.step

    def counted(self, frame):
        frames.append(self._num_lost)
        return step(self, frame)

    monkeypatch.setattr(CameraLoser, "step", counted)
    scores = jobs.evaluate_bundle(tiny_bundle, ["synthetic:5:2"], lost_cameras=True)
    assert frames == [number for number in range(1, 6) for _ in range(2)]
    assert [score.num_lost for score in scores.lost_cameras] == [0, 1, 2, 3, 4, 5]
    report = scores.report
    assert scores.lost_cameras[0] == LostCameraScore(0, report.mean_average_precision, report.nds)
    assert scores.to_dict()["lost_cameras"][0] == {
        "lost": 0,
        "mAP": report.mean_average_precision,
        "NDS": report.nds,
    }
    assert "lost_cameras" not in replace(scores, lost_cameras=()).to_dict()


def test_the_number_of_evaluations_follows_the_smallest_rig():
    class Rigs:
        def __init__(self, *sizes):
            self.sizes = sizes

        def __len__(self):
            return len(self.sizes)

        def frame_without_images(self, index):
            frame = surround_frame()
            return replace(frame, cameras=dict(list(frame.cameras.items())[: self.sizes[index]]))

    assert fewest_cameras([Rigs(6, 5), Rigs(4, 1)]) == 1
    assert fewest_cameras([Rigs(6, 5), Rigs(4, 1)], limit=1) == 4


def test_a_source_with_maps_only_is_refused(tiny_bundle, monkeypatch):
    from duospacenet.jobs import scoring

    monkeypatch.setattr(scoring.EvaluationReport, "has_boxes", False)
    with pytest.raises(InputError, match="--lost-cameras: expected true boxes; synthetic:5:1 has maps only"):
        jobs.evaluate_bundle(tiny_bundle, ["synthetic:5:1"], lost_cameras=True)


def test_a_frame_without_any_image_has_no_detections(pipeline: Pipeline, frames):
    detections = CameraLoser(pipeline.stream(), 6).step(frames[0])
    assert detections.skipped == "every camera is lost"
