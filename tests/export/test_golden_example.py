"""The golden example that an export writes: its scene, its values, and models with other graphs."""

import json
from dataclasses import replace
from math import gcd

import numpy as np
import pytest

from duospacenet.data.results import read_results
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.export.golden_example import write_golden_example
from duospacenet.export.golden_scene import golden_scene
from duospacenet.export.quantization.golden_copy import copy_golden_example
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime.bundle.golden_files import read_expected_values
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.golden_comparison import run_golden_frames
from duospacenet.runtime.golden_sampling import first_difference, sample, sampling_step
from tests.helpers.eager_pipeline import eager_pipeline

TINY = PRESETS["tiny"]
CONFIGS = {
    "PV only": PRESETS["tiny-pv"],
    "BEV only": PRESETS["tiny-bev"],
    "fused BEV": PRESETS["tiny-stacking"],
    "a window of one frame": replace(TINY, num_frames=1),
    "no maps": replace(TINY, map_classes=()),
    "two cameras": replace(TINY, num_cameras=2),
    "one camera": replace(TINY, num_cameras=1),
    "eight cameras": replace(TINY, num_cameras=8),
    "images of another shape": replace(TINY, image=replace(TINY.image, width_px=192, height_px=128)),
}


@pytest.mark.parametrize("name", CONFIGS)
def test_every_kind_of_model_has_a_golden_example(name, tmp_path):
    """The pipeline of the runtime, with graphs in eager mode, gives its values."""
    model = randomise(DuoSpaceNet(CONFIGS[name]), 3).eval()
    record = write_golden_example(tmp_path, model)
    expected = read_expected_values(tmp_path, record)
    frames = list(SceneFolder(tmp_path / record.scene))
    runs = list(run_golden_frames(eager_pipeline(model), frames, expected.frames))
    assert [run.difference for run in runs] == [None] * 3
    windows = [1, 1, 1] if model.config.num_frames == 1 else [1, 2, 3]
    results = list(read_results(tmp_path / record.results))
    assert [run.detections.history.frames for run in runs] == windows
    assert [result["history"]["frames"] for result in results] == windows


def test_one_camera_at_a_time_leaves_out_the_features_of_lost_cameras(tmp_path, monkeypatch):
    """Backbones of large images skip lost cameras, so their features are not compared."""
    monkeypatch.setattr("duospacenet.export.graphs._LARGEST_IMAGE_TOGETHER_PX", 0)
    model = randomise(DuoSpaceNet(TINY), 3).eval()
    expected = read_expected_values(tmp_path, write_golden_example(tmp_path, model))
    pipeline = eager_pipeline(model)
    assert pipeline.manifest.graphs["backbone"].inputs[0].shape[0] == 1
    runs = list(run_golden_frames(pipeline, golden_scene(TINY), expected.frames))
    assert [run.difference for run in runs] == [None] * 3
    values = expected.frames[1].tensors["backbone.reduced_pv_0"].values
    assert 0 < values.count(None) < len(values) / 2


def test_two_examples_of_a_model_are_equal(tmp_path, tiny_model):
    records = [write_golden_example(tmp_path / name, tiny_model) for name in ("a", "b")]
    assert records[0] == records[1]
    size = sum(path.stat().st_size for path in (tmp_path / "a").rglob("*") if path.is_file())
    assert size < 2e6


def test_the_scene_has_every_exact_resize_a_lost_camera_and_another_calibration(tiny_bundle):
    """The sizes of the scaled images, by the rule of the documents."""
    frames = list(SceneFolder(tiny_bundle / "golden" / "scene"))
    factors, cuts = set(), set()
    for camera in frames[0].cameras.values():
        scale = max(160 / camera.width_px, 64 / camera.height_px)
        scaled = round(camera.width_px * scale), round(camera.height_px * scale)
        factors.add((camera.width_px / scaled[0], camera.height_px / scaled[1]))
        cuts.add(((scaled[0] - 160) // 2, scaled[1] - 64))
    assert factors == {(1, 1), (2, 2), (3, 3), (4, 4)}
    assert cuts == {(0, 25), (5, 0)}
    lost = [[name for name, image in frame.images.items() if image is None] for frame in frames]
    assert lost == [[], ["CAM_FRONT_RIGHT"], []]
    poses = [frame.cameras["CAM_FRONT"].camera_T_ego for frame in frames]
    assert np.array_equal(poses[0], poses[1])
    assert not np.allclose(poses[1], poses[2], atol=0.01)
    rotation = frames[0].global_T_ego[:3, :3].T @ frames[2].global_T_ego[:3, :3]
    assert np.abs(rotation - np.eye(3)).max(axis=1).min() > 0.03


def test_every_index_of_every_axis_is_sampled_if_there_are_enough_values():
    for shape in ((6, 64, 160, 3), (6, 2, 1024), (4, 6, 3, 4), (1, 32, 16, 16), (7, 5, 9), (1000,)):
        step = sampling_step("lifter.bev", shape)
        assert all(gcd(step, size) == 1 for size in shape), shape
        indices = np.unravel_index(np.arange(0, np.prod(shape), step), shape)
        assert len(indices[0]) <= 256
        for axis, size in zip(indices, shape, strict=True):
            assert len(set(axis.tolist())) >= min(size, 100), shape
    assert sampling_step("decoder.boxes", (900, 9)) == 1


def test_values_are_compared_by_their_tolerance_and_yaws_modulo_a_turn():
    boxes = np.zeros((2, 9), np.float32)
    expected = sample("decoder.boxes", boxes, 0.01)
    turned = boxes.copy()
    turned[1, 6] = 2 * np.pi + 0.005
    assert first_difference("decoder.boxes", expected, turned) is None
    turned[1, 5] = 0.02
    difference = first_difference("decoder.boxes", expected, turned)
    assert (difference.index, difference.differing, difference.compared) == ((1, 5), 1, 18)
    turned[1, 5] = np.nan
    assert first_difference("decoder.boxes", expected, turned) is not None
    other = sample("decoder.logits", boxes, 0.01).model_copy(update={"compare": "rms", "tolerance": 0.005})
    turned = boxes.copy()
    turned[0, 0] = 0.02  # the RMS of the differences is 0.0047
    assert first_difference("decoder.logits", other, turned) is None
    turned[0, 0] = 0.022
    assert first_difference("decoder.logits", other, turned) is not None


def test_only_graphs_that_read_rounded_values_get_the_tolerance_of_int8(tiny_bundle, tmp_path):
    copy_golden_example(tiny_bundle, read_manifest(tiny_bundle), ["lifter"], tmp_path)
    expected = json.loads((tmp_path / "golden" / "expected.json").read_text())
    compared = {name.split(".")[0]: tensor["compare"] for name, tensor in expected["frames"][0]["tensors"].items()}
    assert {name for name, kind in compared.items() if kind == "each"} == {"inputs", "projector", "backbone"}
    assert {name for name, kind in compared.items() if kind == "rms"} == {"lifter", "decoder", "segmenter", "maps"}
    assert expected["tolerance"] == {"box": None, "score": None}
