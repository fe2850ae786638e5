"""A test that a short training learns: it overfits a few frames and detects nearly all of their objects."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from duospacenet.evaluation import Sample, evaluate
from duospacenet.model import DuoSpaceNet
from duospacenet.model.pose_vectors import decode_boxes
from duospacenet.runtime import Detections, Frame
from duospacenet.runtime.detections import HistoryReport, select_detections
from duospacenet.runtime.frame import GroundTruth
from duospacenet.training import Settings, Trainer, TrainingFolder, TrainingRecord, initialise, train
from duospacenet.training.initial_anchors import find_initial_anchors
from duospacenet.training.samples.batches import make_batches
from duospacenet.training.samples.clip_loader import load_clips, remaining_clips
from duospacenet.training.samples.training_frames import make_training_frame
from duospacenet.training.training_folder import WEIGHTS_NAME
from duospacenet.weights import load_checkpoint
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.trainings import CPU, TINY, FixedClips, synthetic_frames

RANGE_M = 20.0  # the tiny model has 32 queries, fewer than the objects in the full range
SETTINGS = Settings(
    steps=110,
    batch_size=2,
    frames_per_clip=1,
    learning_rate=4e-3,
    backbone_learning_rate=4e-3,
    weight_decay=0.0,
    warmup_steps=10,
    amp="off",
    auxiliary_matches=1,
)


def keep_near_objects(frame: Frame) -> Frame:
    """The frame without the ground-truth boxes beyond RANGE_M."""
    ground_truth = frame.ground_truth
    near = np.hypot(*ground_truth.boxes[:, :2].T) < RANGE_M
    classes = tuple(np.array(ground_truth.classes)[near])
    return replace(frame, ground_truth=GroundTruth(ground_truth.boxes[near], classes, ground_truth.maps))


def detect(model: DuoSpaceNet, frame: Frame) -> Detections:
    """The detections in a single frame, without a history."""
    inputs = make_training_frame(frame, TINY, preprocessing(TINY))
    images, image_T_ego, valid = (field[None] for field in (inputs.images, inputs.image_T_ego, inputs.camera_valid))
    with torch.no_grad():
        output = model(images, image_T_ego, torch.eye(4)[None], torch.zeros(1), torch.ones(1, dtype=torch.bool), valid)
    prediction = output.predictions[-1]
    boxes = decode_boxes(prediction.pose).numpy()
    queries, labels, scores, _ = select_detections(prediction.class_logits.numpy(), boxes)
    classes = tuple(TINY.classes[label] for label in labels)
    return Detections(boxes[queries], scores, classes, queries, HistoryReport(1))


@pytest.mark.slow
def test_a_training_of_110_steps_overfits_2_frames_to_an_map_above_0_9(tmp_path, monkeypatch):
    """Each clip has one frame, and every step uses both clips. The evaluated weights are read from their file.

    The mAP is the mean over nuScenes' distances 0.5, 1, 2 and 4 m and over the 6 classes in these frames. (The
    benchmark's mean counts the other 4 classes as 0.)
    """
    # The default averages the statistics over a hundred steps, which is most of this short run.
    monkeypatch.setattr("duospacenet.training.batch_norm.MOMENTUM", 0.1)
    frames = [keep_near_objects(frame) for frame in synthetic_frames(1, 2)]
    assert all(10 < len(frame.ground_truth.boxes) < TINY.num_queries for frame in frames)
    clips = FixedClips(tuple([frame] for frame in frames))
    anchors = find_initial_anchors(clips.ground_truth(), TINY.num_queries, SETTINGS.seed)
    trainer = Trainer(initialise(DuoSpaceNet(TINY), SETTINGS.seed, anchors), SETTINGS, CPU)
    folder = TrainingFolder(tmp_path, TrainingRecord(TINY, SETTINGS, clips.identity, "random"))
    numbers = remaining_clips(clips, SETTINGS, 0)
    loaded = load_clips(clips, TINY, preprocessing(TINY), numbers, workers=0)
    batches = make_batches(loaded, clips, numbers, SETTINGS)
    assert len(list(train(trainer, folder, batches, save_every=SETTINGS.steps))) == SETTINGS.steps

    model = DuoSpaceNet(TINY).eval()
    load_checkpoint(tmp_path / WEIGHTS_NAME, model)
    report = evaluate(Sample(detect(model, frame), frame.ground_truth) for frame in frames)
    mean_average_precisions = [one.mean_average_precision for one in report.classes if one.num_truth > 0]
    assert len(mean_average_precisions) == 6
    assert np.mean(mean_average_precisions) > 0.9, mean_average_precisions
