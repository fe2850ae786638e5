import pytest

from duospacenet.runtime import Pipeline
from duospacenet.runtime.errors import ArtifactError
from tests.helpers.bundles import edit_manifest
from tests.helpers.json_edits import set_at

CONTRADICTIONS = {
    "a cached value that no graph outputs": (set_at("memory", 0, value="pv_value_9_9"), "memory"),
    "fewer cameras than the graphs have": (set_at("num_cameras", value=5), "num_cameras"),
    "fewer frames than the decoder has": (set_at("window", "num_frames", value=3), "window.num_frames"),
    "more frames than the decoder has": (set_at("window", "num_frames", value=5), "window.num_frames"),
    "fewer classes than logits": (set_at("classes", value=["car"]), "classes"),
    "another image width than the backbone's": (set_at("preprocessing", "width_px", value=320), "preprocessing"),
    "another number of cells than the maps'": (set_at("perception", "size", value=[32, 16, 4]), "perception"),
    "a map class that no graph outputs": (set_at("map_classes", value=["walkway"]), "map_classes"),
}


@pytest.mark.parametrize("contradiction", CONTRADICTIONS)
def test_a_manifest_that_contradicts_its_graphs_is_refused_before_the_first_frame(copied_bundle, contradiction):
    change, field = CONTRADICTIONS[contradiction]
    edit_manifest(copied_bundle, change)
    with pytest.raises(ArtifactError, match=rf"manifest\.json.*{field}"):
        Pipeline.load(copied_bundle)
