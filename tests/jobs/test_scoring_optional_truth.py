"""Sources with boxes only, with masks only, with both for different frames, and bundles without map classes."""

import json
from pathlib import Path

import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.class_names import DETECTION_CLASSES
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs import evaluate_bundle
from duospacenet.jobs.ground_truth_check import check_ground_truth
from duospacenet.runtime.errors import InputError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.scene_files import copy_tree, edit_scene
from tests.helpers.streams import TINY_SIZE_PX, detect_all


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """Two frames with boxes and masks of 48 x 48 cells. The tiny bundle has 16 x 16."""
    folder = tmp_path_factory.mktemp("scenes") / "scene"
    write_scene(folder, SyntheticDrive(5, 2, TINY_SIZE_PX, (48, 48)))
    return folder


def edited(scene: Path, folder: Path, *edits) -> Path:
    """A copy of the scene with these changes to its frames."""
    copied = copy_tree(scene, folder)
    edit_scene(copied, lambda record: [edit(record["frames"]) for edit in edits])
    return copied


def without(field: str, *indices: int):
    def remove(frames: list[dict]) -> None:
        for index in indices:
            del frames[index][field]

    return remove


def test_a_source_with_boxes_only_has_the_same_box_scores_and_no_map_scores(tiny_bundle, scene, tmp_path, capfd):
    both = evaluate_bundle(tiny_bundle, scene).to_dict()
    folder = edited(scene, tmp_path / "boxes", without("maps", 0, 1))
    boxes = evaluate_bundle(tiny_bundle, folder).to_dict()
    assert both["map_samples"] == {"drivable_area": 2, "lane_boundary": 2}
    assert (boxes["map_samples"], boxes["map_iou"], boxes["samples"]) == ({}, {}, 2)
    assert {name: boxes[name] for name in ("mAP", "NDS", "classes")} == {
        name: both[name] for name in ("mAP", "NDS", "classes")
    }
    assert run_app(["eval", str(tiny_bundle), str(folder)]) == 0
    printed = capfd.readouterr().out
    assert "judged: boxes in 2 frames\n" in printed
    assert "not judged: maps, because there are no true masks" in printed


def test_a_source_with_masks_only_has_the_same_map_scores_and_no_box_scores(tiny_bundle, scene, tmp_path, capfd):
    both = evaluate_bundle(tiny_bundle, scene).to_dict()
    folder = edited(scene, tmp_path / "maps", without("boxes", 0, 1))
    maps = evaluate_bundle(tiny_bundle, folder).to_dict()
    assert (maps["samples"], maps["mAP"], maps["NDS"], maps["classes"]) == (0, None, None, {})
    assert maps["map_iou"] == both["map_iou"]
    assert run_app(["eval", str(tiny_bundle), str(folder)]) == 0
    printed = capfd.readouterr().out
    assert "judged: drivable_area in 2 frames, lane_boundary in 2 frames\n" in printed
    assert "not judged: boxes, because no frame has true boxes" in printed
    assert "mAP" not in printed


def test_masks_of_another_grid_are_compared_on_the_grid_of_the_bundle(tiny_bundle, pipeline, scene):
    """The oracle takes the middle one of three cells, and counts in a loop."""
    source = SceneFolder(scene)
    intersection = union = 0
    for frame, found in zip(source, detect_all(pipeline, source, maps=True), strict=True):
        truth = frame.ground_truth.maps["drivable_area"]
        for i in range(16):
            for j in range(16):
                is_true, is_found = truth[3 * i + 1, 3 * j + 1], found.maps["drivable_area"][i, j] > 0.5
                intersection += is_true and is_found
                union += is_true or is_found
    assert evaluate_bundle(tiny_bundle, scene).report.map_iou["drivable_area"] == pytest.approx(intersection / union)


def test_frames_with_boxes_and_frames_with_masks_are_evaluated_separately(tiny_bundle, scene, tmp_path):
    folder = edited(scene, tmp_path / "mixed", without("boxes", 0), without("maps", 1))
    scores = evaluate_bundle(tiny_bundle, folder)
    assert scores.report.num_samples == 1
    assert scores.report.num_map_samples == {"drivable_area": 1, "lane_boundary": 1}


def test_sources_with_boxes_and_sources_with_masks_are_evaluated_together(tiny_bundle, scene, tmp_path):
    boxes = edited(scene, tmp_path / "boxes", without("maps", 0, 1))
    maps = edited(scene, tmp_path / "maps", without("boxes", 0, 1))
    assert (
        evaluate_bundle(tiny_bundle, [boxes, maps]).to_dict()["mAP"]
        == evaluate_bundle(tiny_bundle, boxes).to_dict()["mAP"]
    )


def test_a_source_with_neither_is_refused_before_the_bundle_is_loaded(tiny_bundle, scene, tmp_path, monkeypatch):
    folder = edited(scene, tmp_path / "none", without("boxes", 0, 1), without("maps", 0, 1))
    monkeypatch.setattr("duospacenet.jobs.scoring.Pipeline", None)
    with pytest.raises(
        InputError, match="expected true boxes or masks to compare with, at least in one frame; got none"
    ):
        evaluate_bundle(tiny_bundle, folder)


def test_a_source_with_masks_only_is_refused_for_a_bundle_without_map_classes(pipeline, scene, tmp_path):
    source = SceneFolder(edited(scene, tmp_path / "maps", without("boxes", 0, 1)))
    without_maps = pipeline.manifest.model_copy(update={"map_classes": ()})
    with pytest.raises(InputError, match=r"expected true boxes .* because the bundle has no map classes"):
        check_ground_truth(source, "maps", without_maps)
    check_ground_truth(source, "maps", pipeline.manifest)
    check_ground_truth(SceneFolder(scene), "scene", without_maps)


def test_masks_of_other_classes_than_the_bundles_are_not_evaluated(tiny_bundle, scene, tmp_path):
    def rename(frames: list[dict]) -> None:
        for frame in frames:
            frame["maps"] = {"car_park": frame["maps"]["drivable_area"]}

    folder = edited(scene, tmp_path / "maps", without("boxes", 0, 1), rename)
    with pytest.raises(InputError, match="expected true boxes or masks of the bundle's map classes; got none"):
        evaluate_bundle(tiny_bundle, folder)


def test_no_true_box_of_a_detection_class_is_refused_or_only_warned_about_if_maps_are_evaluated(
    tiny_bundle, scene, tmp_path
):
    def rename(frames: list[dict]) -> None:
        for box in (box for frame in frames for box in frame["boxes"]):
            box["class"] = "animal" if box["class"] in DETECTION_CLASSES else box["class"]

    words, messages = "expected at least one true box of a detection class; got none", []
    with pytest.raises(InputError, match=words):
        evaluate_bundle(tiny_bundle, edited(scene, tmp_path / "refused", rename, without("maps", 0, 1)))
    evaluate_bundle(tiny_bundle, edited(scene, tmp_path / "warned", rename), notify=messages.append)
    assert any(words in message and message.startswith("warning: ") for message in messages)


def test_a_training_uses_the_masks_that_there_are(scene, tmp_path, capfd):
    """The masks have another grid than the model, and the second frame has none."""
    folder = edited(scene, tmp_path / "mixed", without("maps", 1))
    words = ["train", "--preset", "tiny", "--steps", "2", "--batch-size", "1", "--frames-per-clip", "1", "--amp", "off"]
    words += ["--workers", "0", "--warmup-steps", "1", "--source", str(folder), "--out", str(tmp_path / "out")]
    assert run_app(words) == 0
    assert "ground truth: masks in 1 of 2 frames; the maps are trained on these only" in capfd.readouterr().err
    log = [json.loads(line) for line in (tmp_path / "out" / "log.jsonl").read_text().splitlines()]
    assert sorted(step["focal_drivable_area"] > 0 for step in log) == [False, True]


def test_a_training_without_any_mask_says_that_the_maps_are_not_trained(scene, tmp_path, capfd):
    folder = edited(scene, tmp_path / "boxes", without("maps", 0, 1))
    words = ["train", "--preset", "tiny", "--steps", "1", "--batch-size", "1", "--frames-per-clip", "1", "--amp", "off"]
    words += ["--workers", "0", "--warmup-steps", "1", "--source", str(folder), "--out", str(tmp_path / "out")]
    assert run_app(words) == 0
    assert "warning: no frame has true masks, so the maps are not trained" in capfd.readouterr().err
