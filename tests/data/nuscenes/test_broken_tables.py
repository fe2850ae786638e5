"""Broken roots: the error names the table, the row and the token, and the command ends with exit code 3."""

import random
from collections import Counter

import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.nuscenes.nuscenes_source import NuscenesSource
from duospacenet.data.nuscenes.table_set import TABLE_NAMES
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.validation import check_frame
from tests.helpers.json_mutations import mutate
from tests.helpers.nuscenes_tables import VERSION, row, tiny_tables, write_tables


def set_field(table, row_token, **fields):
    return lambda tables: row(tables, table, row_token).update(fields)


def remove_field(table, token, field):
    return lambda tables: row(tables, table, token).pop(field)


def remove_row(table, token):
    return lambda tables: tables[table].remove(row(tables, table, token))


def repeat_row(table, token, new_token=None):
    return lambda tables: tables[table].append({**row(tables, table, token), "token": new_token or token})


DANGLING = {
    "sample of an unknown scene": (
        set_field("sample", "b0", scene_token="lost"),
        r"sample\.json: row 2, token 'b0': expected scene_token to name a row of the table scene; got 'lost'",
    ),
    "scene of an unknown log": (
        set_field("scene", "s61", log_token="lost"),
        r"scene\.json: row 1, token 's61': expected log_token to name a row of the table log; got 'lost'",
    ),
    "data of an unknown sample": (
        set_field("sample_data", "b0-CAM_BACK", sample_token="lost"),
        r"sample_data\.json: row 2, token 'b0-CAM_BACK': expected sample_token .* table sample; got 'lost'",
    ),
    "data of an unknown calibration": (
        set_field("sample_data", "b0-CAM_BACK", calibrated_sensor_token="lost"),
        r"sample_data\.json: row 2, token 'b0-CAM_BACK': expected calibrated_sensor_token .*; got 'lost'",
    ),
    "an ego pose that is not there": (
        remove_row("ego_pose", "b1-CAM_FRONT"),
        r"sample_data\.json: row 8, token 'b1-CAM_FRONT': expected ego_pose_token .* ego_pose; got 'b1-CAM_FRONT'",
    ),
    "calibration of an unknown sensor": (
        set_field("calibrated_sensor", "ccf", sensor_token=""),
        r"calibrated_sensor\.json: row 1, token 'ccf': expected sensor_token .* table sensor; got ''",
    ),
    "annotation of an unknown sample": (
        set_field("sample_annotation", "bus2", sample_token="lost"),
        r"sample_annotation\.json: row 1, token 'bus2': expected sample_token .* sample; got 'lost'",
    ),
    "annotation of an unknown object": (
        set_field("sample_annotation", "bus2", instance_token="lost"),
        r"sample_annotation\.json: row 1, token 'bus2': expected instance_token .* instance; got 'lost'",
    ),
    "annotation of an unknown category": (
        remove_row("category", "c-rack"),
        r"instance\.json: row 1, token 'rack': expected category_token .* category; got 'c-rack'",
    ),
    "annotation with an unknown attribute": (
        remove_row("attribute", "t-stopped"),
        r"sample_annotation\.json: row 1, token 'bus2': expected attribute_tokens .* attribute; got 't-stopped'",
    ),
    "annotation with an unknown visibility": (
        set_field("sample_annotation", "bus2", visibility_token="9"),
        r"sample_annotation\.json: row 1, token 'bus2': expected visibility_token .* visibility; got '9'",
    ),
    "annotation after an unknown one": (
        set_field("sample_annotation", "bus1", prev="lost"),
        r"sample_annotation\.json: row 2, token 'bus1': expected prev .* sample_annotation; got 'lost'",
    ),
    "annotation before an unknown one": (
        remove_row("sample_annotation", "bus2"),
        r"sample_annotation\.json: row 1, token 'bus1': expected next .* sample_annotation; got 'bus2'",
    ),
}
WRONG = {
    "no token": (remove_field("sample", "b0", "token"), r"sample\.json: row 2, token '': .*`token`"),
    "a row that is a number": (
        lambda tables: tables["log"].append(3),
        r"log\.json: row 1, token '': Expected `object`",
    ),
    "a field of another type": (
        set_field("sample", "b0", timestamp="now"),
        r"sample\.json: row 2, token 'b0': Expected `float`, got `str` at `\.timestamp`",
    ),
    "a missing field": (
        remove_field("ego_pose", "b0-LIDAR_TOP", "rotation"),
        r"ego_pose\.json: row 0, token 'b0-LIDAR_TOP': .* missing required field `rotation`",
    ),
    "a rotation of three numbers": (
        set_field("sample_annotation", "bus0", rotation=[1, 0, 0]),
        r"sample_annotation\.json: row 0, token 'bus0': Expected `array` of length 4",
    ),
    "a width of zero": (
        set_field("sample_annotation", "bus0", size=[0, 10, 3]),
        r"sample_annotation\.json: row 0, token 'bus0': Expected `float` > 0",
    ),
    "a negative number of points": (
        set_field("sample_annotation", "bus0", num_lidar_pts=-1),
        r"sample_annotation\.json: row 0, token 'bus0': Expected `int` >= 0",
    ),
    "two attributes": (
        set_field("sample_annotation", "bus0", attribute_tokens=["t-moving", "t-stopped"]),
        r"sample_annotation\.json: row 0, token 'bus0': expected at most one attribute; got 2",
    ),
    "the same annotation twice": (
        repeat_row("sample_annotation", "bus0"),
        r"sample_annotation\.json: row 4, token 'bus0': expected each token once; got that of row 0 again",
    ),
    "the same sample twice": (repeat_row("sample", "b0"), r"sample\.json: row 4, token 'b0': expected each token once"),
    "the same ego pose twice": (
        repeat_row("ego_pose", "b0-CAM_FRONT"),
        r"ego_pose\.json: row 16, token 'b0-CAM_FRONT': expected each token once; got that of row 3 again",
    ),
    "two scenes of one name": (
        set_field("scene", "s61", name="scene-0103"),
        r"scene\.json: row 1, token 's61': expected each name of a scene once; got that of row 0 again",
    ),
    "two samples at one time": (
        set_field("sample", "b1", timestamp=1_500_000_000_000_000),
        r"sample\.json: row 3, token 'b1': expected each timestamp of a scene once; got that of row 2 again",
    ),
    "lidar times in another order": (
        set_field("sample_data", "b1-LIDAR_TOP", timestamp=1_400_000_000_000_000),
        r"sample\.json: row 3, token 'b1': expected its lidar key frame later than 1500000000000000 us",
    ),
    "two images of one camera": (
        repeat_row("sample_data", "b1-CAM_FRONT", "again"),
        r"sample_data\.json: row 20, token 'again': expected each camera of a key frame once; got that of row 8",
    ),
    "two lidar sweeps": (
        repeat_row("sample_data", "b1-LIDAR_TOP", "again"),
        r"sample_data\.json: row 20, token 'again': expected each key frame of LIDAR_TOP once; got that of row 6",
    ),
    "no lidar sweep": (
        set_field("sample_data", "b1-LIDAR_TOP", is_key_frame=False),
        r"sample\.json: row 3, token 'b1': expected a key frame of LIDAR_TOP in the table sample_data",
    ),
    "a quaternion of length 2": (
        set_field("sample_annotation", "bus2", rotation=[2, 0, 0, 0]),
        r"sample_annotation\.json: row 1, token 'bus2': expected a quaternion of length 1; got 2",
    ),
    "a zero quaternion of the ego": (
        set_field("ego_pose", "b1-CAM_BACK", rotation=[0, 0, 0, 0]),
        r"ego_pose\.json: row 6, token 'b1-CAM_BACK': expected a quaternion of length 1; got 0",
    ),
    "a zero quaternion of a camera": (
        set_field("calibrated_sensor", "ccf", rotation=[0, 0, 0, 0]),
        r"calibrated_sensor\.json: row 1, token 'ccf': expected a quaternion of length 1; got 0",
    ),
    "a vehicle on its side": (
        set_field("ego_pose", "b1-LIDAR_TOP", rotation=[2**-0.5, 2**-0.5, 0, 0]),
        r"ego_pose\.json: row 4, token 'b1-LIDAR_TOP': expected an upright vehicle; got .*w first",
    ),
    "a position beyond the Earth": (
        set_field("ego_pose", "b1-LIDAR_TOP", translation=[1e300, 0, 0]),
        r"ego_pose\.json: row 4, token 'b1-LIDAR_TOP': expected a translation of at most 1e\+09 m",
    ),
    "a camera without intrinsics": (
        set_field("calibrated_sensor", "ccf", camera_intrinsic=[]),
        r"calibrated_sensor\.json: row 1, token 'ccf': expected camera_intrinsic as a 3x3 matrix; got 0 rows",
    ),
    "lens distortion": (
        set_field("calibrated_sensor", "ccf", camera_distortion=[-0.3, 0.1, 0, 0, 0]),
        r"calibrated_sensor\.json: row 1, token 'ccf': expected images without lens distortion; .*Rectify",
    ),
    "an image without a size": (
        set_field("sample_data", "b0-CAM_BACK", width=0),
        r"sample_data\.json: row 2, token 'b0-CAM_BACK': expected the width and height of the image; got 0 and 16",
    ),
    "an image of a billion pixels": (
        set_field("sample_data", "b0-CAM_BACK", width=2**40),
        r"sample_data\.json: row 2, token 'b0-CAM_BACK': Expected `int` <= 1000000",
    ),
    "an image outside the root": (
        set_field("sample_data", "b0-CAM_BACK", filename="samples/../../secret.jpg"),
        r"sample_data\.json: row 2, token 'b0-CAM_BACK': expected a file inside the root; got 'samples/",
    ),
    "a path of an image without a name": (
        set_field("sample_data", "b0-CAM_BACK", filename="samples/.."),
        r"sample_data\.json: row 2, token 'b0-CAM_BACK': expected a file inside the root",
    ),
    "an absolute path of an image": (
        set_field("sample_data", "b0-CAM_BACK", filename="/etc/secret.jpg"),
        r"sample_data\.json: row 2, token 'b0-CAM_BACK': expected a file inside the root",
    ),
    "a control character in a name": (
        set_field("category", "c-rack", name="a\x1b[2J"),
        r"category\.json: row 0, token 'c-rack': expected name without control characters, .* got 'a\\x1b\[2J'",
    ),
    "a control character in a token": (
        set_field("sample", "b0", token="b\n0"),
        r"sample\.json: row 2, token 'b\\n0': expected a token of printable ASCII characters",
    ),
    "a name of a million characters": (
        set_field("sensor", "cf", channel="C" * 10**6),
        r"sensor\.json: row \d+, token 'cf': expected channel of at most 1000 characters; got 1000000: 'CCC",
    ),
    "a path of a million characters": (
        set_field("sample_data", "b0-CAM_BACK", filename="a/" * 500_000 + "b"),
        r"sample_data\.json: row 2, token 'b0-CAM_BACK': expected filename of at most 1000 characters; got 1000001",
    ),
    "many coefficients of lens distortion": (
        set_field("calibrated_sensor", "ccf", camera_distortion=[0.1] * 50_000),
        r"calibrated_sensor\.json: row 1, token 'ccf': expected images without lens distortion; .*Rectify",
    ),
    "a time beyond all clocks": (
        set_field("sample_data", "b1-LIDAR_TOP", timestamp=1e308),
        r"sample_data\.json: row 6, token 'b1-LIDAR_TOP': Expected `float` <= 1e\+?20 at `\.timestamp`",
    ),
    "a box beyond the Earth": (
        set_field("sample_annotation", "bus0", size=[1e300, 1e300, 1e300]),
        r"sample_annotation\.json: row 0, token 'bus0': Expected `float` <= 1",
    ),
    "no samples": (lambda tables: tables.update(sample=[], sample_data=[], sample_annotation=[]), "got none"),
}


@pytest.mark.parametrize("case", DANGLING | WRONG)
def test_a_wrong_row_is_named_with_its_table_and_token(tmp_path, case):
    change, message = (DANGLING | WRONG)[case]
    tables = tiny_tables()
    change(tables)
    with pytest.raises(InputError, match=message) as error:
        NuscenesSource(str(write_tables(tmp_path, tables)))
    assert str(tmp_path / VERSION) in str(error.value)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < len(str(tmp_path)) + 400
    assert not str(error.value).endswith("?.")


def test_two_attributes_of_an_object_of_no_detection_class_count_as_none(tmp_path):
    tables = tiny_tables()
    row(tables, "sample_annotation", "rack0")["attribute_tokens"] = ["t-moving", "t-stopped"]
    source = NuscenesSource(str(write_tables(tmp_path, tables)))
    assert source.ground_truth_without_maps(1).attributes == ("vehicle.moving", "")


@pytest.mark.parametrize("name", TABLE_NAMES)
def test_a_missing_table_is_named(tmp_path, name):
    (write_tables(tmp_path, tiny_tables()) / VERSION / f"{name}.json").unlink()
    with pytest.raises(InputError, match=rf"/{name}\.json: expected the nuScenes table {name}; got no such file"):
        NuscenesSource(str(tmp_path))


@pytest.mark.parametrize("name", TABLE_NAMES)
def test_a_truncated_table_is_named_with_its_last_complete_row(tmp_path, name):
    tables = tiny_tables()
    path = write_tables(tmp_path, tables) / VERSION / f"{name}.json"
    content = path.read_bytes()
    path.write_bytes(content[:-20])
    last = len(tables[name]) - 2
    place = f"; the last complete row is {last}, token '{tables[name][last]['token']}'" if last >= 0 else ""
    with pytest.raises(InputError, match=rf"/{name}\.json: expected a JSON array of rows; .*truncated\){place}\. Unp"):
        NuscenesSource(str(tmp_path))


def test_damage_inside_a_table_is_reported_with_the_row_before_it(tmp_path):
    path = write_tables(tmp_path, tiny_tables()) / VERSION / "sample_data.json"
    content = path.read_bytes()
    place = content.index(b'"b0-CAM_FRONT"')
    path.write_bytes(content[:place] + b"\0" + content[place + 1 :])
    with pytest.raises(InputError, match=r"sample_data\.json: .*the last complete row is 2, token 'b0-CAM_BACK'\. Unp"):
        NuscenesSource(str(tmp_path))


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"null", b"\xff\xfe[]", b"[{]", b'[{"token": "\xff"}]', b"version https", b"[" * 100_000]
)
def test_a_file_that_is_not_a_table_is_refused(tmp_path, content):
    (write_tables(tmp_path, tiny_tables()) / VERSION / "log.json").write_bytes(content)
    with pytest.raises(InputError, match=r"/log\.json: "):
        NuscenesSource(str(tmp_path))


@pytest.mark.parametrize("row_start", [b'{"token": "x", "other": ', b'{"name": "x", "token": '])
def test_a_row_of_many_levels_is_refused(tmp_path, row_start):
    content = b"[" + row_start + b"[" * 100_000 + b"]" * 100_000 + b"}]"
    (write_tables(tmp_path, tiny_tables()) / VERSION / "log.json").write_bytes(content)
    with pytest.raises(InputError, match=r"/log\.json: .*recursion"):
        NuscenesSource(str(tmp_path))


def test_randomly_changed_tables_are_read_or_refused_by_name(tmp_path):
    rng = random.Random(0)
    names = sorted(tiny_tables())
    outcomes = Counter()
    for number in range(400):
        tables = tiny_tables()
        name = rng.choice(names)
        tables[name] = mutate(rng, tables[name])
        root = write_tables(tmp_path / str(number), tables)
        try:
            source = NuscenesSource(str(root))
            for index in range(len(source)):
                check_frame(source.frame_without_images(index), num_cameras=6)
                source.ground_truth_without_maps(index)
            outcomes["read"] += 1
        except InputError as error:
            assert str(root / VERSION) in str(error)
            assert str(error).isprintable()
            outcomes["refused"] += 1
    assert outcomes["refused"] > 100
    assert outcomes["read"] > 15


@pytest.mark.parametrize(
    "change", [remove_row("category", "c-rack"), set_field("category", "c-rack", name="hovercraft")]
)
def test_the_command_ends_with_exit_code_3(tmp_path, capfd, change):
    tables = tiny_tables()
    change(tables)
    source = f"nuscenes:{write_tables(tmp_path, tables)}"
    assert run_app(["anchors", source, "--queries", "1", "--out", str(tmp_path / "anchors.json")]) == 3
    error = " ".join(capfd.readouterr().err.split())
    assert ".json" in error and "row " in error and "token " in error
