"""A camera that leaves a blind sector is found by its counterpart on the other side."""

from duospacenet.rig.blind_sectors import find_blind_sectors
from duospacenet.rig.turned_cameras import turned_camera_findings
from tests.helpers.rigs import COARSE, level_camera, mount_position

POSITIONS = {"FRONT": 0, "LEFT": 80, "BACK": 180, "RIGHT": -80}


def findings(azimuths_deg):
    cameras = {name: level_camera(azimuths_deg[name], mount_position(POSITIONS[name])) for name in azimuths_deg}
    sectors = find_blind_sectors(cameras, COARSE, None)
    return dict(turned_camera_findings(cameras, sectors, COARSE, None))


def test_the_turned_camera_is_named_and_its_counterpart_is_not():
    found = findings({"FRONT": 0, "LEFT": 115, "BACK": 180, "RIGHT": -90})
    assert list(found) == ["LEFT"]
    assert "wrong by about 25 degrees" in found["LEFT"].cause


def test_symmetric_rigs_and_rigs_that_lack_a_camera_have_no_finding():
    assert findings({"FRONT": 0, "LEFT": 90, "BACK": 180, "RIGHT": -90}) == {}
    assert findings({"FRONT": 0, "LEFT": 80, "RIGHT": -80}) == {}
    assert findings({"FRONT": 0, "LEFT": 110, "BACK": 180, "RIGHT": -110}) == {}
