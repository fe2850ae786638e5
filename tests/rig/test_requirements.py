"""Requirements of a bundle on a rig."""

from duospacenet.rig import RigRequirements
from duospacenet.runtime.bundle.manifest import read_manifest


def test_limits_of_the_motion_come_from_the_manifest(tiny_bundle):
    manifest = read_manifest(tiny_bundle)
    limits = {"largest_time_delta_s": 1.5, "largest_speed_m_s": 9.0, "largest_turn_rad_s": 0.5}
    slow = manifest.model_copy(update={"window": manifest.window.model_copy(update=limits)})
    requirements = RigRequirements.from_manifest(slow)
    assert {name: getattr(requirements, name) for name in limits} == limits
