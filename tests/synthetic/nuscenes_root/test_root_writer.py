"""A written root has the layout of nuScenes: its tables, their links and its files."""

from collections import defaultdict

import cv2
import pytest

from duospacenet.runtime.errors import OutputError, UsageError
from tests.helpers.nuscenes_roots import IMAGE_SIZE, PlainTables, write_small_root

CAMERAS = {"CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT"}
# The schema that nuScenes publishes: fields of the rows by table.
FIELDS = {
    "attribute": {"token", "name", "description"},
    "calibrated_sensor": {"token", "sensor_token", "translation", "rotation", "camera_intrinsic"},
    "category": {"token", "name", "description"},
    "ego_pose": {"token", "timestamp", "rotation", "translation"},
    "instance": {"token", "category_token", "nbr_annotations", "first_annotation_token", "last_annotation_token"},
    "log": {"token", "logfile", "vehicle", "date_captured", "location"},
    "map": {"token", "category", "filename", "log_tokens"},
    "sample": {"token", "timestamp", "prev", "next", "scene_token"},
    "sample_annotation": {
        "token",
        "sample_token",
        "instance_token",
        "visibility_token",
        "attribute_tokens",
        "translation",
        "size",
        "rotation",
        "prev",
        "next",
        "num_lidar_pts",
        "num_radar_pts",
    },
    "sample_data": {
        "token",
        "sample_token",
        "ego_pose_token",
        "calibrated_sensor_token",
        "timestamp",
        "fileformat",
        "is_key_frame",
        "height",
        "width",
        "filename",
        "prev",
        "next",
    },
    "scene": {"token", "log_token", "nbr_samples", "first_sample_token", "last_sample_token", "name", "description"},
    "sensor": {"token", "channel", "modality"},
    "visibility": {"token", "level", "description"},
}
LINKS = {  # fields that name a row of another table; "" is allowed for prev and next only
    "calibrated_sensor": {"sensor_token": "sensor"},
    "instance": {
        "category_token": "category",
        "first_annotation_token": "sample_annotation",
        "last_annotation_token": "sample_annotation",
    },
    "sample": {"scene_token": "scene"},
    "sample_annotation": {"sample_token": "sample", "instance_token": "instance", "visibility_token": "visibility"},
    "sample_data": {
        "sample_token": "sample",
        "ego_pose_token": "ego_pose",
        "calibrated_sensor_token": "calibrated_sensor",
    },
    "scene": {"log_token": "log", "first_sample_token": "sample", "last_sample_token": "sample"},
}


def test_all_tables_have_the_published_fields(tables):
    assert set(tables.rows) == set(FIELDS)
    for name, rows in tables.rows.items():
        assert rows, name
        assert all(set(row) == FIELDS[name] for row in rows), name


def test_every_token_is_unique_and_every_link_leads_to_a_row(tables):
    for name, rows in tables.rows.items():
        assert len(tables.by_token[name]) == len(rows), name
    for name, fields in LINKS.items():
        for row in tables.rows[name]:
            assert all(row[field] in tables.by_token[table] for field, table in fields.items())
    assert all(log in tables.by_token["log"] for row in tables.rows["map"] for log in row["log_tokens"])
    assert {log for row in tables.rows["map"] for log in row["log_tokens"]} == set(tables.by_token["log"])


@pytest.mark.parametrize(
    ("table", "group_of"),
    [
        ("sample", lambda tables, row: row["scene_token"]),
        ("sample_data", lambda tables, row: row["calibrated_sensor_token"]),
        ("sample_annotation", lambda tables, row: row["instance_token"]),
    ],
)
def test_prev_and_next_link_the_rows_of_a_scene_a_sensor_and_a_track_in_time(tables, table, group_of):
    def time(row):
        return row["timestamp"] if "timestamp" in row else tables.get("sample", row["sample_token"])["timestamp"]

    groups = defaultdict(list)
    for row in tables.rows[table]:
        groups[group_of(tables, row)].append(row)
    for rows in groups.values():
        rows.sort(key=time)
        assert len({time(row) for row in rows}) == len(rows)
        tokens = [row["token"] for row in rows]
        assert [row["prev"] for row in rows] == ["", *tokens[:-1]]
        assert [row["next"] for row in rows] == [*tokens[1:], ""]


def test_every_sample_has_the_images_of_six_cameras_at_their_own_times_and_a_lidar_at_its_own(tables):
    for sample in tables.rows["sample"]:
        data = tables.data_of(sample)
        assert set(data) == CAMERAS | {"LIDAR_TOP"}
        assert data["LIDAR_TOP"]["timestamp"] == sample["timestamp"]
        times = {data[camera]["timestamp"] for camera in CAMERAS}
        assert len(times) == len(CAMERAS)
        assert all(-50_000 < time - sample["timestamp"] < 0 for time in times)
        for row in data.values():
            assert tables.get("ego_pose", row["ego_pose_token"])["timestamp"] == row["timestamp"]
            assert (tables.root / row["filename"]).is_file()
        for camera in CAMERAS:
            image = cv2.imread(str(tables.root / data[camera]["filename"]))
            assert (image.shape[1], image.shape[0]) == (data[camera]["width"], data[camera]["height"]) == IMAGE_SIZE


def test_the_lidar_has_sweeps_that_belong_to_no_key_frame(tables):
    sweeps = [row for row in tables.rows["sample_data"] if not row["is_key_frame"]]
    assert {tables.channel(row) for row in sweeps} == {"LIDAR_TOP"}
    assert len(sweeps) == len(tables.rows["sample"]) - len(tables.rows["scene"])


def test_counts_and_ends_of_scenes_and_tracks_are_right(tables):
    for scene in tables.rows["scene"]:
        samples = [row for row in tables.rows["sample"] if row["scene_token"] == scene["token"]]
        samples.sort(key=lambda row: row["timestamp"])
        assert scene["nbr_samples"] == len(samples)
        assert (scene["first_sample_token"], scene["last_sample_token"]) == (samples[0]["token"], samples[-1]["token"])
    for instance in tables.rows["instance"]:
        track = [row for row in tables.rows["sample_annotation"] if row["instance_token"] == instance["token"]]
        assert instance["nbr_annotations"] == len(track)
        assert instance["first_annotation_token"] in {row["token"] for row in track if not row["prev"]}
        assert instance["last_annotation_token"] in {row["token"] for row in track if not row["next"]}


def test_scenes_have_names_of_both_splits(tables):
    assert [scene["name"] for scene in tables.rows["scene"]] == ["scene-0061", "scene-0103"]


def test_the_same_seed_gives_the_same_files(tmp_path):
    first, second = (write_small_root(tmp_path / name, 1, 2, seed=5) for name in "ab")
    files = sorted(path.relative_to(first) for path in first.rglob("*") if path.is_file())
    assert len(files) == 13 + 2 * 7 + 1 + 2  # tables; key frames of two samples; a sweep; a map and its picture
    assert files == sorted(path.relative_to(second) for path in second.rglob("*") if path.is_file())
    assert all((first / path).read_bytes() == (second / path).read_bytes() for path in files)


def test_the_test_split_has_no_annotations(tmp_path):
    tables = PlainTables(write_small_root(tmp_path / "root", 1, 1, split="test"), "v1.0-test")
    assert tables.rows["sample_annotation"] == tables.rows["instance"] == []
    assert tables.rows["scene"][0]["name"] == "scene-0077"


def test_an_existing_folder_is_left_as_it_is(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match="expected a new folder; it exists already"):
        write_small_root(tmp_path, 1, 1)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_nothing_remains_after_an_interruption(tmp_path):
    def interrupted(frames, description, total):
        for number, frame in enumerate(frames):
            if number == 2:
                assert len(list(tmp_path.iterdir())) == 1  # the staging directory
                raise KeyboardInterrupt
            yield frame

    with pytest.raises(KeyboardInterrupt):
        write_small_root(tmp_path / "root", 1, 4, progress=interrupted)
    assert list(tmp_path.iterdir()) == []


def test_more_scenes_than_a_split_has_are_refused(tmp_path):
    with pytest.raises(UsageError, match="expected at most 2, the scenes of mini_val; got 3"):
        write_small_root(tmp_path / "root", 3, 1, split="mini_val")
    assert list(tmp_path.iterdir()) == []
