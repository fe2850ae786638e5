"""A manifest that contradicts itself or its graphs is refused."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.consistency import check_consistency
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


def tensors(**shapes):
    return [SimpleNamespace(name=name.replace("__", "."), shape=shape) for name, shape in shapes.items()]


def consistent_manifest(**changes):
    """A manifest whose sizes all differ: 5 cameras, 3 frames, 7 classes, 48x96 px, 16x20 cells."""
    graphs = {
        "backbone": SimpleNamespace(inputs=tensors(images=(5, 48, 96, 3)), outputs=tensors(pv=(5, 8), pv_value=(1, 9))),
        "projector": SimpleNamespace(inputs=tensors(camera_valid=(5,)), outputs=[]),
        "lifter": SimpleNamespace(inputs=[], outputs=tensors(bev=(1, 32, 16, 20), bev_value=(1, 11))),
        "decoder": SimpleNamespace(
            inputs=tensors(
                frame_valid=(3,), **{f"slot{t}__{name}": (1,) for t in range(3) for name in ("pv_value", "bev")}
            ),
            outputs=tensors(class_logits=(30, 7)),
        ),
        "segmenter": SimpleNamespace(inputs=[], outputs=tensors(drivable_area=(1, 1, 16, 20))),
    }
    fields = {
        "graphs": graphs,
        "num_cameras": 5,
        "preprocessing": SimpleNamespace(height_px=48, width_px=96),
        "classes": tuple("abcdefg"),
        "map_classes": ("drivable_area",),
        "perception": SimpleNamespace(size=(16, 20, 4)),
        "window": SimpleNamespace(num_frames=3),
        "memory": ("pv_value", "bev"),
    }
    return SimpleNamespace(**fields | changes)


def test_a_consistent_manifest_is_accepted():
    check_consistency(Path("bundle"), consistent_manifest())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_cameras": 6}, "num_cameras: expected 5, as in its graphs; got 6"),
        ({"preprocessing": SimpleNamespace(height_px=96, width_px=96)}, "preprocessing.height_px: expected 48.*got 96"),
        ({"preprocessing": SimpleNamespace(height_px=48, width_px=48)}, "preprocessing.width_px: expected 96.*got 48"),
        ({"classes": tuple("abcdef")}, "classes: expected 7 names.*got 6 names"),
        ({"map_classes": ()}, r"map_classes: expected \('drivable_area',\).*got \(\)"),
        ({"perception": SimpleNamespace(size=(20, 16, 4))}, r"perception.size: expected \(16, 20\).*got \(20, 16\)"),
        ({"window": SimpleNamespace(num_frames=2)}, "window.num_frames: expected 3.*got 2"),
        (
            {"memory": ("pv_value", "other")},
            r"memory, names that no graph outputs: expected \[\].*got \['other'\]",
        ),
        (
            {"memory": ("pv_value",)},
            r"memory, slots that differ from the decoder's inputs: .*got \['slot0.bev', 'slot1.bev', 'slot2.bev'\]",
        ),
        (
            {"memory": ("pv_value", "bev", "bev_value")},
            r"memory, slots that differ from the decoder's inputs: .*got \['slot0.bev_value',",
        ),
    ],
)
def test_each_field_is_compared_with_the_tensors_of_the_graphs(changes, message):
    with pytest.raises(ArtifactError, match=rf"bundle/manifest\.json: field {message}"):
        check_consistency(Path("bundle"), consistent_manifest(**changes))


@pytest.mark.parametrize("number", [1, 5])
def test_the_backbone_may_take_a_part_of_the_cameras_at_a_time(number):
    check_consistency(Path("bundle"), consistent_manifest(graphs=with_cameras_per_run(number)))


@pytest.mark.parametrize("number", [2, 3, 4, 6, 10])
def test_a_number_of_cameras_that_the_backbone_cannot_divide_is_refused(number):
    with pytest.raises(ArtifactError, match=f"num_cameras: expected a multiple of {number}, .*got 5"):
        check_consistency(Path("bundle"), consistent_manifest(graphs=with_cameras_per_run(number)))


@pytest.mark.parametrize("graph", ["decoder", "projector"])
def test_the_number_of_cameras_is_that_of_the_decoder_or_else_of_the_projector(graph):
    """Five in the decoder and four in the projector; a decoder without PV attention has no cameras."""
    graphs = consistent_manifest().graphs
    projector = SimpleNamespace(inputs=tensors(camera_valid=(4,)), outputs=[])
    decoder = SimpleNamespace(inputs=[*graphs["decoder"].inputs], outputs=graphs["decoder"].outputs)
    if graph == "decoder":
        decoder.inputs += tensors(camera_valid=(3, 5))
    graphs = with_cameras_per_run(1) | {"projector": projector, "decoder": decoder}
    check_consistency(Path("bundle"), consistent_manifest(graphs=graphs, num_cameras=5 if graph == "decoder" else 4))


def with_cameras_per_run(number):
    """The graphs, with a backbone for `number` cameras at a time."""
    backbone = consistent_manifest().graphs["backbone"]
    images = tensors(images=(number, 48, 96, 3))
    return consistent_manifest().graphs | {"backbone": SimpleNamespace(inputs=images, outputs=backbone.outputs)}


def test_graphs_without_the_tensors_or_axes_are_refused_and_not_an_internal_error():
    for graph in ("backbone", "decoder"):
        graphs = consistent_manifest().graphs | {graph: SimpleNamespace(inputs=[], outputs=[])}
        with pytest.raises(ArtifactError, match="expected None"):
            check_consistency(Path("bundle"), consistent_manifest(graphs=graphs))
    flat = {"backbone": SimpleNamespace(inputs=tensors(images=(5,)), outputs=[])}
    with pytest.raises(ArtifactError, match="height_px: expected None"):
        check_consistency(Path("bundle"), consistent_manifest(graphs=consistent_manifest().graphs | flat))


def test_a_bundle_without_a_lifter_or_segmenter_has_no_cells_and_no_maps_to_compare():
    graphs = consistent_manifest().graphs
    without = {name: graphs[name] for name in ("backbone", "decoder")}
    without["decoder"] = SimpleNamespace(
        inputs=tensors(camera_valid=(3, 5), frame_valid=(3,), **{f"slot{t}__pv_value": (1,) for t in range(3)}),
        outputs=tensors(class_logits=(30, 7)),
    )
    check_consistency(Path("bundle"), consistent_manifest(graphs=without, memory=("pv_value",), map_classes=()))
