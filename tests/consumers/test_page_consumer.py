"""The pages of the bundle format are enough: a consumer that was written from them equals the pipeline."""

import ast
import re
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest

from duospacenet.data.scene_folder import SceneFolder
from duospacenet.model import PRESETS
from duospacenet.model.config import ImageConfig
from duospacenet.runtime import Camera, Frame, Pipeline
from duospacenet.runtime.detections import select_detections
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.preprocessing import resize_transform
from duospacenet.weights.input_contract import preprocessing as input_contract
from tests.consumers import page_consumer
from tests.consumers.page_consumer import Consumer, read_scene
from tests.helpers.consumer_drive import write_consumer_drive

PAGE = Path(__file__).parents[2] / "docs" / "frame-steps.md"
SKIPPED, RESETS = ["04", "13"], ["07", "09", "11", "12", "17"]  # tokens of the drive's frames


def open_session(content):
    """A session on the thread pool of this process, in which a pipeline is loaded."""
    options = ort.SessionOptions()
    options.use_per_session_threads = False
    return ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])


@pytest.fixture(scope="module")
def drive(tiny_bundle, tmp_path_factory):
    """A drive with resets, lost and absent cameras, calibration changes, and images of several sizes."""
    return write_consumer_drive(tiny_bundle, tmp_path_factory.mktemp("consumer") / "drive")


def test_the_consumer_of_the_page_gives_the_detections_of_the_pipeline(tiny_bundle, drive):
    stream = Pipeline.load(tiny_bundle).stream()
    consumer, skipped, resets = Consumer(tiny_bundle, open_session), [], []
    for frame, values in zip(SceneFolder(drive), read_scene(drive), strict=True):
        expected, found = stream.step(frame), consumer.step(values)
        if found is None or expected.skipped:
            assert (found is None) == (expected.skipped is not None)
            skipped.append(frame.token)
            continue
        boxes, scores, labels, num_frames, is_reset = found
        names = tuple(consumer.manifest["classes"][label] for label in labels)
        assert np.array_equal(boxes, expected.boxes), frame.token
        assert np.array_equal(scores, expected.scores), frame.token
        assert (names, num_frames) == (expected.classes, expected.history.frames)
        assert is_reset == (expected.history.reset_reason is not None)
        resets += [frame.token] * is_reset
    assert (skipped, resets) == (SKIPPED, RESETS)


def test_the_consumer_of_the_page_refuses_a_repeated_time_stamp_and_changes_nothing(tiny_bundle, drive):
    stream, consumer = Pipeline.load(tiny_bundle).stream(), Consumer(tiny_bundle, open_session)
    frames, values = list(islice(SceneFolder(drive), 2)), list(islice(read_scene(drive), 2))
    for index in (0, 1):
        stream.step(frames[index])
        consumer.step(values[index])
    with pytest.raises(InputError, match="expected later than"):
        stream.step(frames[1])
    with pytest.raises(ValueError, match="not later"):
        consumer.step(values[1])
    assert consumer.past[0]["timestamp_s"] == frames[1].timestamp_s
    assert [past["timestamp_s"] for past in consumer.past] == [frames[1].timestamp_s, frames[0].timestamp_s]


def test_the_consumer_of_the_page_selects_detections_as_the_pipeline_does():
    """Equal scores keep their order, and queries with numbers that are not finite are dropped."""
    generator = np.random.default_rng(5)
    logits = generator.integers(-3, 3, (90, 10)).astype(np.float32)  # many equal scores
    boxes = generator.normal(size=(90, 9)).astype(np.float32)
    logits[3, 1], boxes[7, 8], logits[11] = np.nan, np.inf, np.float32(200)
    queries, labels, scores, dropped = select_detections(logits, boxes)
    found = page_consumer.select(logits, boxes)
    assert dropped == 2
    assert np.array_equal(found[0], boxes[queries])
    assert np.array_equal(found[1], scores)
    assert np.array_equal(found[2], labels)


def rows_of(heading):
    """The cells of the rows of a table in docs/frame-steps.md, which starts with the cells `heading`."""
    text = PAGE.read_text()
    table = text[text.index(f"| {heading} |") :].split("\n\n")[0].splitlines()
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in table[2:]]


def test_the_worked_sizes_of_the_page_are_those_of_the_pipeline():
    rows = rows_of("W0×H0 | scale | Ws×Hs | left, top | resize")
    assert len(rows) == 6
    preprocessing = input_contract(replace(PRESETS["tiny"], image=ImageConfig(400, 160)))
    for native, scale, scaled, offsets, resize in rows:
        width, height = map(int, native.split("×"))
        scaled_width, scaled_height = map(int, re.match(r"(\d+)×(\d+)", scaled).groups())
        left, top = map(int, offsets.split(","))
        assert float(scale) == round(max(400 / width, 160 / height), 4)
        expected = [[scaled_width / width, 0, -left], [0, scaled_height / height, -top], [0, 0, 1]]
        camera = Camera(np.eye(3), np.eye(4), width, height)
        assert resize_transform(camera, preprocessing).tolist() == expected
        kinds = {1: "halved once", 2: "halved twice", 0: "`INTER_AREA`" if scaled_width < width else "`INTER_LINEAR`"}
        factor = {(2, 0): 1, (4, 0): 2}.get(divmod(width, scaled_width), 0)
        is_exact = (scaled_width << factor, scaled_height << factor) == (width, height)
        assert resize == kinds[factor if is_exact else 0]


def test_the_worked_drive_of_the_page_is_processed_as_it_says(tiny_bundle):
    stream = Pipeline.load(tiny_bundle).stream()
    camera = Camera(np.array([[80.0, 0, 80], [0, 80, 32], [0, 0, 1]]), np.eye(4), 160, 64)
    results = []
    for event, expected in rows_of("example, in order of arrival | result"):
        scene, time_s = re.match(r"scene (\w), ([\d.]+) s", event).groups()
        image = None if "no images" in event else np.zeros((64, 160, 3), np.uint8)
        frame = Frame({"C": image}, {"C": camera}, np.eye(4), float(time_s), scene)
        try:
            detections = stream.step(frame)
        except InputError:
            found = "refused"
        else:
            found = "skipped" if detections.skipped else f"a window of {detections.history.frames}"
            assert ("reset" in expected) == (detections.history.reset_reason is not None)
        results.append(found)
        assert found in expected, event
    assert results == [f"a window of {n}" if n else kind for n, kind in EVENTS]


EVENTS = [(1, ""), (2, ""), (0, "refused"), (0, "skipped"), (0, "skipped"), (3, ""), (1, ""), (1, "")]


def test_the_consumer_of_the_page_uses_nothing_of_this_toolkit():
    tree = ast.parse(Path(page_consumer.__file__).read_text())
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert imported == {"hashlib", "json", "re", "cv2", "numpy"}
    assert not any(isinstance(node, ast.ImportFrom) for node in ast.walk(tree))
