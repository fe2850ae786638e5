"""The golden example of a bundle: it passes with the exported graphs, and finds faults of graphs and of consumers."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from duospacenet.export.golden_example import write_golden_example
from duospacenet.jobs.golden_check import check_golden_example
from duospacenet.model import DuoSpaceNet, randomise
from duospacenet.runtime import pipeline, preprocessing
from duospacenet.runtime.errors import ArtifactError
from duospacenet.runtime.geometry import image_T_ego
from tests.faults import stream_faults
from tests.faults.bench import Bench
from tests.faults.catalogue import FAULTS
from tests.helpers.bundles import edit_manifest


@pytest.fixture
def bench(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        yield bench


def difference_after(bench, fault):
    fault(bench)
    difference = check_golden_example(bench.bundle).difference
    assert difference is not None, "the golden example missed the fault"
    return difference


def test_the_graphs_of_an_export_give_the_values_of_eager_mode(tiny_bundle):
    check = check_golden_example(tiny_bundle)
    assert check.difference is None
    assert check.passed
    assert (check.frames, check.engine["name"]) == (3, "onnxruntime")
    assert check.values > 10_000


def test_an_int8_bundle_has_the_values_of_its_float32_bundle(tiny_int8_bundle, tiny_bundle):
    assert check_golden_example(tiny_int8_bundle).passed
    rounded, exact = (json.loads((b / "golden/expected.json").read_text()) for b in (tiny_int8_bundle, tiny_bundle))
    for quantized, original in zip(rounded["frames"], exact["frames"], strict=True):
        for name, tensor in original["tensors"].items():
            assert quantized["tensors"][name]["values"] == tensor["values"]
            is_rounded = name.split(".")[0] not in ("inputs", "projector")
            assert quantized["tensors"][name]["compare"] == ("rms" if is_rounded else "each"), name


# By name of the fault in the catalogue: the tensor in which it must be found.
GRAPH_FAULTS = {
    "RGB for BGR in the graph": "backbone.",
    "the projector's pixels shifted by half a pixel": "projector.voxel_locations",
    "x and y of the BEV grid exchanged": "decoder.class_logits",
    "two class columns exchanged": "decoder.class_logits[0, ",
    "slot 1 read instead of slot 2": "frame 2 (golden-2), decoder.class_logits",
    "ego motion replaced by the identity": "frame 1 (golden-1), decoder.",
    "a map transposed": "segmenter.drivable_area",
}
CONSUMER_FAULTS = {
    "RGB for BGR": "frame 0 (golden-0), inputs.images",
    "another resize kernel": "inputs.images",
    "intrinsics without the crop": "inputs.image_T_ego",
    "black image for a lost camera": "frame 1 (golden-1), inputs.camera_valid[0, 1]: expected 0; got 1",
    "past_T_now transposed": "inputs.past_T_now[1, 0, 1]",
    "current calibration in all slots": "inputs.image_T_ego[1, ",
    "history never updated": "frame 2 (golden-2), inputs.",
    "history reset at every frame": "frame 1 (golden-1), inputs.",
    "cached values of two slots exchanged": "decoder.class_logits",
    "lifting tables never recomputed": "frame 1 (golden-1), projector.",
    "class names shifted by one": "results.jsonl: boxes[0]: expected ",
    "the five best boxes missing": "results.jsonl: boxes: expected 320; got 315",
}
BY_NAME = {fault.name: fault.inject for fault in FAULTS if not fault.is_shared}


@pytest.mark.parametrize("name", GRAPH_FAULTS)
def test_a_wrong_graph_is_found(bench, name):
    assert GRAPH_FAULTS[name] in difference_after(bench, BY_NAME[name])


@pytest.mark.parametrize("name", CONSUMER_FAULTS)
def test_a_wrong_consumer_is_found(bench, name):
    assert CONSUMER_FAULTS[name] in difference_after(bench, BY_NAME[name])


def pixel_centres_at_integers(prepare):
    """The intrinsics are scaled as if the centre of the first pixel was at (0, 0)."""

    def broken(frame, settings, num_cameras):
        inputs = prepare(frame, settings, num_cameras)
        for slot, camera in enumerate(frame.cameras.values()):
            resized = preprocessing.resize_transform(camera, settings)
            to_integers, to_halves = np.eye(3), np.eye(3)
            to_integers[:2, 2], to_halves[:2, 2] = -0.5, 0.5
            shifted = to_halves @ resized @ to_integers
            inputs.image_T_ego[slot] = image_T_ego(shifted @ camera.intrinsics_px, camera.camera_T_ego)
        return inputs

    return broken


def test_a_missing_half_pixel_of_a_consumer_is_found(bench):
    difference = difference_after(bench, stream_faults.in_stream_preparation(pixel_centres_at_integers))
    assert "inputs.image_T_ego" in difference


def test_a_map_that_a_consumer_transposes_is_found(bench):
    segment = pipeline.Stream._segment

    def transposed(self, *arguments):
        maps, dropped = segment(self, *arguments)
        return {name: mask.T for name, mask in maps.items()}, dropped

    difference = difference_after(bench, lambda bench: bench.patch("_segment", transposed, pipeline.Stream))
    assert "maps.drivable_area[" in difference


def test_width_and_length_that_a_consumer_exchanges_are_found(bench):
    step = pipeline.Stream.step

    def exchanged(self, frame):
        detections = step(self, frame)
        return replace(detections, boxes=detections.boxes[:, [0, 1, 2, 4, 3, 5, 6, 7, 8]])

    difference = difference_after(bench, lambda bench: bench.patch("step", exchanged, pipeline.Stream))
    assert "frame 0 (golden-0), results.jsonl: boxes[0]: expected " in difference


# --- Damage ----------------------------------------------------------------------------------------------------------


DAMAGE = {
    "a changed value": ("expected.json", lambda path: path.write_text(path.read_text().replace("1", "2", 1))),
    "half an image": (
        "scene/images/CAM_FRONT/000000.png",
        lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    ),
    "no results": ("results.jsonl", lambda path: path.unlink()),
    "a further file": ("scene/extra.png", lambda path: path.write_bytes(b"")),
    "a link": ("scene/images/other", lambda path: path.symlink_to("CAM_FRONT")),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_golden_file_is_refused_and_named(copied_bundle, kind):
    name, damage = DAMAGE[kind]
    damage(copied_bundle / "golden" / name)
    with pytest.raises(ArtifactError, match=f"golden/{name}: "):
        check_golden_example(copied_bundle)


def test_a_bundle_without_a_golden_example_runs_but_cannot_be_verified(copied_bundle):
    shutil.rmtree(copied_bundle / "golden")
    pipeline.Pipeline.load(copied_bundle)  # a run never reads the golden example
    edit_manifest(copied_bundle, lambda manifest: manifest.update(golden=None))
    with pytest.raises(ArtifactError, match="expected a golden example"):
        check_golden_example(copied_bundle)


def test_expected_values_of_another_model_are_refused(copied_bundle, tiny_model):
    """The files fit the manifest, but their tensors are not those of the graphs."""
    other = DuoSpaceNet(replace(tiny_model.config, num_queries=8))
    shutil.rmtree(copied_bundle / "golden")
    record = write_golden_example(copied_bundle, randomise(other, 0).eval())
    edit_manifest(copied_bundle, lambda manifest: manifest.update(golden=record.model_dump(mode="json")))
    with pytest.raises(ArtifactError, match=r"tensors\.decoder\.class_logits: expected float32 \(32, 10\)"):
        check_golden_example(copied_bundle)


def test_a_path_that_leads_out_of_the_golden_folder_is_refused(copied_bundle):
    path = "golden/../manifest.json"
    edit_manifest(copied_bundle, lambda manifest: manifest["golden"]["sha256"].update({path: "0" * 64}))
    with pytest.raises(ArtifactError, match="expected a file below golden/"):
        check_golden_example(copied_bundle)
