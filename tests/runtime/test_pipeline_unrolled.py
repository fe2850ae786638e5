from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.helpers.streams import TINY_SIZE_PX, detect_all, lose_cameras, turn_cameras

NUM_FRAMES, NUM_CAMERAS = 4, 6
TOLERANCE = 1e-3


@pytest.fixture(autouse=True)
def one_thread():
    """Limits torch to one thread. Its pool and onnxruntime's would otherwise wait for each other on the same cores."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@torch.no_grad()
def unrolled(model, window):
    """Return logits (Q, classes), boxes (Q, 9) and maps of one PyTorch forward over a window, newest frame first.

    The relative poses and times are computed here from the frames, independently of the runtime.
    """
    width, height = TINY_SIZE_PX
    images = np.zeros((NUM_FRAMES, NUM_CAMERAS, height, width, 3), np.uint8)
    image_T_ego = np.zeros((NUM_FRAMES, NUM_CAMERAS, 3, 4))
    past_T_now = np.tile(np.eye(4), (NUM_FRAMES, 1, 1))
    time_delta_s = np.zeros(NUM_FRAMES)
    camera_valid = np.zeros((NUM_FRAMES, NUM_CAMERAS), bool)
    for t, frame in enumerate(window):
        past_T_now[t] = np.linalg.inv(frame.global_T_ego) @ window[0].global_T_ego
        time_delta_s[t] = window[0].timestamp_s - frame.timestamp_s
        for n, (name, camera) in enumerate(frame.cameras.items()):
            image_T_ego[t, n] = camera.intrinsics_px @ camera.camera_T_ego[:3]
            if frame.images[name] is not None:
                images[t, n], camera_valid[t, n] = frame.images[name], True
    output = model(
        torch.from_numpy(images),
        torch.from_numpy(image_T_ego).float(),
        torch.from_numpy(past_T_now).float(),
        torch.from_numpy(time_delta_s).float(),
        torch.arange(NUM_FRAMES) < len(window),
        torch.from_numpy(camera_valid),
    )
    logits, pose = (value.double().numpy() for value in output.predictions[-1])
    yaw = np.arctan2(pose[:, 6], pose[:, 7])
    boxes = np.column_stack([pose[:, :3], np.exp(pose[:, 3:6]), yaw, pose[:, 8:]])
    return logits, boxes, {name: probability(mask[0, 0].double().numpy()) for name, mask in output.maps.items()}


def probability(logits):
    return 1 / (1 + np.exp(-logits))


def assert_equals_unrolled(detections, model, window):
    """Assert that boxes of the same query and class are equal to those of the unrolled model, and none is missing."""
    logits, boxes, maps = unrolled(model, window)
    scores, labels = probability(logits), [model.config.classes.index(name) for name in detections.classes]
    off = detections.boxes - boxes[detections.queries]
    off[:, 6] = np.angle(np.exp(1j * off[:, 6]))
    assert np.abs(off).max() < TOLERANCE
    assert np.abs(detections.scores - scores[detections.queries, labels]).max() < TOLERANCE
    detected = set(zip(detections.queries.tolist(), labels, strict=True))
    above_threshold = zip(*np.nonzero(scores > detections.scores[-1] + TOLERANCE), strict=True)
    assert len(detected) == len(detections) == 320
    assert detected.issuperset((int(query), int(label)) for query, label in above_threshold)
    assert detections.history.frames == len(window)
    for name, mask in detections.maps.items():
        np.testing.assert_allclose(mask, maps[name], atol=TOLERANCE)


def test_streamed_equals_unrolled_while_the_window_fills_and_slides(pipeline, tiny_model, frames):
    results = detect_all(pipeline, frames[:5], maps=True)
    for k, result in enumerate(results, start=1):
        window = frames[:k][::-1][:NUM_FRAMES]
        assert set(result.maps) == {"drivable_area", "lane_boundary"}
        assert_equals_unrolled(result, tiny_model, window)


def test_streamed_equals_unrolled_after_a_reset(pipeline, tiny_model, frames):
    stream = pipeline.stream()
    for frame in frames[:3]:
        stream.step(frame)
    stream.reset()
    assert_equals_unrolled(stream.step(frames[3]), tiny_model, [frames[3]])
    assert_equals_unrolled(stream.step(frames[4]), tiny_model, [frames[4], frames[3]])


def test_streamed_equals_unrolled_after_a_scene_change(pipeline, tiny_model, frames, other_frames):
    results = detect_all(pipeline, [*frames[:3], *other_frames[:2]])
    assert_equals_unrolled(results[3], tiny_model, [other_frames[0]])
    assert_equals_unrolled(results[4], tiny_model, [other_frames[1], other_frames[0]])


def test_streamed_equals_unrolled_with_lost_cameras_now_and_in_the_past(pipeline, tiny_model, frames):
    drive = [
        frames[0],
        lose_cameras(frames[1], "CAM_FRONT"),
        lose_cameras(frames[2], "CAM_BACK", "CAM_FRONT_LEFT"),
        frames[3],
    ]
    for k, result in enumerate(detect_all(pipeline, drive), start=1):
        assert_equals_unrolled(result, tiny_model, drive[:k][::-1])


def test_streamed_equals_unrolled_when_the_calibration_changes(pipeline, tiny_model, frames):
    drive = [frames[0], frames[1], turn_cameras(frames[2]), frames[3]]
    for k, result in enumerate(detect_all(pipeline, drive), start=1):
        assert_equals_unrolled(result, tiny_model, drive[:k][::-1])


def test_streamed_equals_unrolled_when_the_ego_turns_and_climbs(pipeline, tiny_model, frames):
    drive = []
    for k, frame in enumerate(frames[:4]):
        yaw, pitch = 0.3 * k, 0.05 * k
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        tilt = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn @ tilt, [4.0 * k, 1.5 * k, 0.4 * k]
        drive.append(replace(frame, global_T_ego=pose))
    assert_equals_unrolled(detect_all(pipeline, drive)[-1], tiny_model, drive[::-1])


def test_past_frames_change_the_detections(pipeline, frames):
    warm, cold = detect_all(pipeline, frames[:4])[-1], detect_all(pipeline, frames[3:4])[-1]
    by_query = [dict(zip(zip(d.queries, d.classes, strict=True), d.scores, strict=True)) for d in (warm, cold)]
    common = by_query[0].keys() & by_query[1].keys()
    assert max(abs(by_query[0][key] - by_query[1][key]) for key in common) > 20 * TOLERANCE
