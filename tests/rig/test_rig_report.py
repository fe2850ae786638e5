"""The content of rig.json."""

import json

import numpy as np

from duospacenet.rig.rig_report import rig_report_dict
from tests.helpers.rigs import change_extrinsics, change_intrinsics, examine_source, write_rig


def test_the_report_is_strict_json_for_any_numbers(tmp_path):
    def set_extreme_numbers(scene):
        change_extrinsics("FRONT", lambda m: m * 1e300)(scene)
        change_intrinsics("LEFT", lambda k: k * 1e-300)(scene)
        change_intrinsics("RIGHT", np.zeros_like)(scene)
        change_extrinsics("BACK", np.zeros_like)(scene)

    examination = examine_source(write_rig(tmp_path / "rig", set_extreme_numbers))
    report = json.loads(
        json.dumps(rig_report_dict("rig", examination, dict.fromkeys(examination.views, "")), allow_nan=False)
    )
    assert {camera["verdict"] for camera in report["cameras"].values()} == {"broken"}
    assert report["cameras"]["BACK"]["position_m"] == [None] * 3
    assert report["rig"]["voxels_seen_by"] is None
    assert report["rig"]["blind_sectors_deg"] == [[0, 360]]
