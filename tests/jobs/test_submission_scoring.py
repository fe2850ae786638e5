"""Submissions against nuscenes-devkit 1.2.0 on the same root, and the submissions that are refused."""

from pathlib import Path

import pytest

from duospacenet.data.scene_writer import write_scene
from duospacenet.jobs import evaluate_bundle, evaluate_submission, run
from duospacenet.runtime.errors import InputError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.devkit_scores import DevkitCase, Scores, devkit_scores, flat_scores, largest_difference
from tests.helpers.handmade_root import SPLIT, VERSION, HandmadeRoot
from tests.helpers.noisy_submission import META, noisy_submission, write_submission_json
from tests.helpers.nuscenes_roots import PlainTables, write_small_root

TOLERANCE = 1e-9
NAN = float("nan")
RACK = "static_object.bicycle_rack"


@pytest.fixture(autouse=True)
def cache_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("DUOSPACENET_CACHE", str(tmp_path / "cache"))


def detected(annotation: dict, name: str, score: float = 0.9, shift_m: tuple = (0, 0, 0), **fields) -> dict:
    """A detection of an annotation."""
    box = {key: annotation[key] for key in ("sample_token", "size", "rotation")}
    box["translation"] = [value + shift for value, shift in zip(annotation["translation"], shift_m, strict=True)]
    box |= {"velocity": [0.0, 0.0], "detection_name": name, "detection_score": score, "attribute_name": ""}
    return box | fields


def submission_of(root: HandmadeRoot, *boxes: dict) -> dict:
    tokens = [root.token(sample) for sample in range(root.num_samples)]
    return {
        "meta": META,
        "results": {token: [box for box in boxes if box["sample_token"] == token] for token in tokens},
    }


def bicycles_in_a_rack(root: HandmadeRoot) -> list[dict]:
    """The rack is 2 m wide and 6 m long, along global y. One bicycle is inside, one 3.1 m from its centre."""
    root.add(RACK, (10, 5, 0), size=[2.0, 6.0, 2.0], rotation=[0.5**0.5, 0, 0, 0.5**0.5])
    inside = root.add("vehicle.bicycle", (10.5, 7.5, 0.2))
    outside = root.add("vehicle.bicycle", (10, 8.1, 0))
    pedestrian = root.add("human.pedestrian.adult", (10, 5, 0))
    return [
        detected(inside, "bicycle", 0.9),
        detected(outside, "bicycle", 0.5),
        detected(pedestrian, "pedestrian", 0.7),
        detected(inside, "motorcycle", 0.8),
    ]


def boxes_without_points(root: HandmadeRoot) -> list[dict]:
    """Radar points count as well. A detection may say that it has no points, and is then left out."""
    seen = root.add("vehicle.car", (5, 0, 0), points=0, num_radar_pts=1)
    unseen = root.add("vehicle.car", (5, 9, 0), points=0)
    return [
        detected(seen, "car", 0.6),
        detected(unseen, "car", 0.8),
        detected(seen, "car", 0.7, num_pts=0),
        detected(seen, "car", 0.5, num_pts=3, ego_translation=[1.0, 2.0, 3.0]),
    ]


def velocities(root: HandmadeRoot) -> list[dict]:
    """A track, an object that is annotated once, and a detection of unknown velocity."""
    track = root.add_track("vehicle.truck", [(8, -3, 0), (6, -1, 0.5), (7, 2, -0.5)], attribute="vehicle.moving")
    once = root.add("vehicle.truck", (-20, 4, 0), attribute="vehicle.parked")
    moving = {"velocity": [-1.0, 2.0], "attribute_name": "vehicle.moving"}
    return [
        detected(track[0], "truck", 0.9, **moving),
        detected(track[1], "truck", 0.8, velocity=[NAN, NAN], attribute_name="vehicle.stopped"),
        detected(track[2], "truck", 0.7, **moving),
        detected(once, "truck", 0.95, (0.2, 0.1, 0), **moving),
    ]


def boxes_at_the_range(root: HandmadeRoot) -> list[dict]:
    """50 m for a car, 30 m for a barrier, measured along the global axes: the vehicle is pitched and rolled.

    A box exactly at the range is left out.
    """
    names = ("vehicle.car", "car", 50), ("movable_object.barrier", "barrier", 30)
    boxes = []
    for category, name, range_m in names:
        near = root.add(category, (0, range_m - 0.001, 5))
        far = [root.add(category, offset) for offset in ((-range_m, 0, -5), (0.6 * range_m, 0.8 * range_m, 0))]
        boxes += [detected(near, name, 0.4), detected(near, name, 0.6, (0, 0.5, 0)), detected(near, name, 0.7)]
        boxes += [detected(annotation, name, 0.5) for annotation in far]
    return boxes


def distances_that_just_do_not_match(root: HandmadeRoot) -> list[dict]:
    """A distance of exactly 0.5, 1, 2 or 4 m is no match."""
    cars = [root.add("vehicle.car", (10 * number - 20, number / 8, 0)) for number in range(5)]
    pairs = zip(cars, (0.5, 1, 2, 4, 0.25), strict=True)
    return [detected(car, "car", 0.9 - shift / 10, (0, shift, 0)) for car, shift in pairs]


def equal_scores(root: HandmadeRoot) -> list[dict]:
    """Of equal scores the last one in the file comes first, within a sample and across samples."""
    boxes = []
    for sample in range(root.num_samples):
        for number in range(4):
            car = root.add("vehicle.car", (4 * number, 10 * sample - 10, 0), sample=sample)
            boxes += [detected(car, "car", 0.5, (shift, 0, 0)) for shift in (1.5, 0.3, 0.0, 3.0)]
    return boxes


def attributes(root: HandmadeRoot) -> list[dict]:
    """Right, wrong and missing attributes, of detections and of annotations."""
    sitting = root.add("human.pedestrian.adult", (3, 3, 0), attribute="pedestrian.sitting_lying_down")
    unknown = root.add("human.pedestrian.child", (-3, 3, 0))
    standing = root.add("human.pedestrian.adult", (-3, -8, 0), attribute="pedestrian.standing")
    return [
        detected(sitting, "pedestrian", 0.9, attribute_name="pedestrian.sitting_lying_down"),
        detected(unknown, "pedestrian", 0.8, attribute_name="pedestrian.moving"),
        detected(standing, "pedestrian", 0.7, attribute_name=""),
    ]


def headings(root: HandmadeRoot) -> list[dict]:
    """Quaternions that are tilted or not of length 1, and barriers, whose heading has a period of 180 degrees."""
    car = root.add("vehicle.car", (7, 1, 0), rotation=[0.7, 0.1, -0.1, 0.7])
    barrier = root.add("movable_object.barrier", (-7, 1, 0), rotation=[0.2, 0, 0, 0.9797958971132712])
    return [
        detected(car, "car", 0.9, rotation=[0.2, 0.4, 0.1, 2.0]),
        detected(barrier, "barrier", 0.9, rotation=[-0.9, 0, 0, 0.3], velocity=[5.0, 1.0]),
    ]


def only_false_boxes(root: HandmadeRoot) -> list[dict]:
    """A class without annotations, and one whose detections are all far away."""
    car = root.add("vehicle.car", (5, 0, 0))
    return [detected(car, "bus", 0.9), detected(car, "car", 0.8, (6, 0, 0))]


CASES = [
    bicycles_in_a_rack,
    boxes_without_points,
    velocities,
    boxes_at_the_range,
    distances_that_just_do_not_match,
    equal_scores,
    attributes,
    headings,
    only_false_boxes,
]


@pytest.fixture(scope="module")
def crafted_scores(tmp_path_factory) -> dict[str, tuple[Scores, Scores]]:
    """Our scores and those of the devkit by case. The devkit evaluates all cases in one process."""
    ours, devkit_cases = [], []
    for case in CASES:
        folder, root = tmp_path_factory.mktemp(case.__name__), HandmadeRoot()
        submission = write_submission_json(folder / "submission.json", submission_of(root, *case(root)))
        root.write(folder / "root")
        with pytest.MonkeyPatch.context() as environment:
            environment.setenv("DUOSPACENET_CACHE", str(folder / "cache"))
            report = evaluate_submission(submission, f"nuscenes:{folder / 'root'}/{SPLIT}").to_dict()
        ours.append(flat_scores(report))
        devkit_cases.append(DevkitCase(folder / "root", VERSION, SPLIT, submission))
    pairs = zip(ours, devkit_scores(*devkit_cases), strict=True)
    return {case.__name__: pair for case, pair in zip(CASES, pairs, strict=True)}


@pytest.mark.slow
@pytest.mark.parametrize("name", [case.__name__ for case in CASES])
def test_a_crafted_case_has_the_scores_of_the_devkit(name, crafted_scores):
    assert largest_difference(*crafted_scores[name]) < TOLERANCE


@pytest.mark.slow
def test_six_scenes_have_the_scores_of_the_devkit(tmp_path):
    root = write_small_root(tmp_path / "root", 6, 4, image_size=(32, 18), split="val")
    tables = PlainTables(root, "v1.0-trainval")
    file = write_submission_json(
        tmp_path / "submission.json", noisy_submission(tables, [row["name"] for row in tables.rows["scene"]])
    )
    report = evaluate_submission(file, f"nuscenes:{root}/val").to_dict()
    (devkit,) = devkit_scores(DevkitCase(root, "v1.0-trainval", "val", file))
    assert largest_difference(flat_scores(report), devkit) < TOLERANCE
    # The case is only worth something if all metrics are far from their bounds, and boxes are left out.
    assert 0.1 < report["mAP"] < 0.9
    assert all(0.05 < error < 0.95 for error in report["errors"].values())
    assert {"class", "range", "no_points"} <= report["ground_truth"]["left_out"].keys()


@pytest.mark.slow
def test_the_scores_of_a_bundle_are_those_of_its_submission(tiny_bundle, tmp_path):
    """`eval BUNDLE`, `eval --results` and the devkit agree on the same run; the boxes are those of the submission."""
    root = write_small_root(tmp_path / "root", 2, 3, image_size=(320, 128))
    source = f"nuscenes:{root}/mini_train"
    run(tiny_bundle, source, tmp_path / "run", formats="nuscenes")
    bundle = flat_scores(evaluate_bundle(tiny_bundle, source).to_dict())
    submission = tmp_path / "run" / "results_nusc.json"
    assert largest_difference(bundle, flat_scores(evaluate_submission(submission, source).to_dict())) == 0
    (devkit,) = devkit_scores(DevkitCase(root, "v1.0-mini", "mini_train", submission))
    assert largest_difference(bundle, devkit) < TOLERANCE
    assert bundle["car.detections"] > 30


def small_root(tmp_path: Path) -> tuple[HandmadeRoot, str, dict]:
    """A root of two samples with one car each, its source, and its submission with both cars."""
    root = HandmadeRoot(num_samples=2)
    cars = root.add_track("vehicle.car", [(5, 0, 0), (6, 0, 0)])
    root.write(tmp_path / "root")
    return root, f"nuscenes:{tmp_path / 'root'}", submission_of(root, *(detected(car, "car") for car in cars))


def test_the_scores_name_the_submission_its_meta_and_the_source(tmp_path):
    _, source, submission = small_root(tmp_path)
    file = write_submission_json(tmp_path / "submission.json", submission)
    scores = evaluate_submission(file, source).to_dict()
    assert (scores["submission"], scores["meta"]) == (str(file), META)
    assert scores["sources"][0].startswith("nuScenes v1.0-mini, sha256 ")
    assert scores["samples"] == 2
    assert scores["classes"]["car"]["mean_AP"] == pytest.approx(1)
    assert scores["true_attributes"] == "annotated"


def test_a_missing_sample_is_refused_with_its_token(tmp_path):
    root, source, submission = small_root(tmp_path)
    del submission["results"][root.token(1)]
    file = write_submission_json(tmp_path / "submission.json", submission)
    with pytest.raises(InputError, match=r"submission\.json: expected each .*; 1 are missing, such as 'sample 1'"):
        evaluate_submission(file, source)


def test_a_sample_of_another_split_is_refused_with_its_token(tmp_path):
    _, source, submission = small_root(tmp_path)
    file = write_submission_json(tmp_path / "submission.json", submission)
    submission["results"]["of another split"] = []
    file = write_submission_json(tmp_path / "submission.json", submission)
    with pytest.raises(InputError, match=r"submission\.json: expected only sample tokens .*; got 'of another split'"):
        evaluate_submission(file, source)


def test_a_source_without_annotations_is_refused_before_the_submission_is_read(tmp_path):
    HandmadeRoot(num_samples=2).write(tmp_path / "root")
    (tmp_path / "submission.json").write_text("not JSON")
    with pytest.raises(InputError, match=r"expected true boxes to compare with.*The split `test` of nuScenes has no"):
        evaluate_submission(tmp_path / "submission.json", f"nuscenes:{tmp_path / 'root'}")


def test_a_missing_submission_is_refused_before_the_source_is_opened(tmp_path):
    with pytest.raises(InputError, match=r"submission\.json: expected a file; got no such file"):
        evaluate_submission(tmp_path / "submission.json", "nuscenes:/no/such/root")


def test_the_same_frames_twice_are_refused(tmp_path):
    _, source, submission = small_root(tmp_path)
    file = write_submission_json(tmp_path / "submission.json", submission)
    with pytest.raises(InputError, match="got 'sample 0' for the second time"):
        evaluate_submission(file, [source, source])


def test_a_scene_folder_takes_a_submission_too(tiny_bundle, tmp_path):
    write_scene(tmp_path / "scene", SyntheticDrive(5, 2, (320, 128)))
    run(tiny_bundle, tmp_path / "scene", tmp_path / "run", formats="nuscenes")
    scores = evaluate_submission(tmp_path / "run" / "results_nusc.json", tmp_path / "scene").to_dict()
    direct = evaluate_bundle(tiny_bundle, tmp_path / "scene").to_dict()
    assert scores["classes"] == direct["classes"]
