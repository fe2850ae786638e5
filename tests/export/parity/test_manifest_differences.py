"""Every field of the contract is compared with the model's configuration."""

import pytest

from duospacenet.export.graphs import graphs_to_export
from duospacenet.export.operator_forms import OperatorForms
from duospacenet.export.parity.manifest_differences import manifest_differences
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime.bundle.manifest import Manifest, read_manifest
from duospacenet.weights.provenance import record_random_weights


@pytest.fixture(scope="module")
def manifest(tiny_bundle, tiny_model):
    """The manifest of an export from random weights. `tiny_bundle` was exported without their provenance."""
    return read_manifest(tiny_bundle).model_copy(update={"weights": record_random_weights(tiny_model, 0)})


@pytest.fixture(scope="module")
def graphs(tiny_model):
    return graphs_to_export(tiny_model)


def test_the_manifest_of_an_export_has_no_difference(manifest, tiny_model, graphs):
    weights = record_random_weights(tiny_model, 0)
    assert manifest_differences(manifest, tiny_model, graphs, OperatorForms(), weights) == []


CHANGES = {
    "classes": lambda values: values["classes"].reverse(),
    "map_classes": lambda values: values["map_classes"].reverse(),
    "num_cameras": lambda values: values.update(num_cameras=5),
    "preprocessing.width_px": lambda values: values["preprocessing"].update(width_px=161),
    "preprocessing.normalisation_in_graph.mean": lambda values: values["preprocessing"][
        "normalisation_in_graph"
    ].update(mean=[0.0, 0.0, 0.0]),
    "window.num_frames": lambda values: values["window"].update(num_frames=3),
    "window.nominal_time_delta_s": lambda values: values["window"].update(nominal_time_delta_s=0.1),
    "window.largest_time_delta_s": lambda values: values["window"].update(largest_time_delta_s=0.6),
    "window.largest_speed_m_s": lambda values: values["window"].update(largest_speed_m_s=0.01),
    "window.largest_turn_rad_s": lambda values: values["window"].update(largest_turn_rad_s=0.1),
    "perception.lower_m": lambda values: values["perception"].update(lower_m=[-5.0, -5.0, -3.0]),
    "perception.size": lambda values: values["perception"].update(size=[8, 8, 4]),
    "frames_of_reference.ego": lambda values: values["frames_of_reference"].update(ego="x right, y forward"),
    "tensors.class_logits": lambda values: values["tensors"].pop("class_logits"),
    "memory": lambda values: values["memory"].reverse(),
    "dcn": lambda values: values.update(dcn="native"),
    "attention": lambda values: values.update(attention="grid-sample"),
    "preset": lambda values: values.update(preset="nano"),
    "config.num_heads": lambda values: values["config"].update(num_heads=8),
    "config.divergence_enhancement": lambda values: values["config"].update(divergence_enhancement=False),
    "graphs.decoder.outputs": lambda values: values["graphs"]["decoder"]["outputs"].reverse(),
    "weights.sha256": lambda values: values["weights"].update(sha256="0" * 64),
    "weights.trained": lambda values: values["weights"].update(trained=True),
}


@pytest.mark.parametrize("field", CHANGES)
def test_a_changed_field_is_named_with_both_values(field, manifest, tiny_model, graphs):
    values = manifest.model_dump(mode="json")
    CHANGES[field](values)
    changed = Manifest.model_validate(values)
    weights = record_random_weights(tiny_model, 0)
    differences = manifest_differences(changed, tiny_model, graphs, OperatorForms(), weights)
    assert [difference.field for difference in differences] == [field]
    assert differences[0].expected != differences[0].actual


@pytest.mark.filterwarnings("ignore:Pydantic serializer warnings")
@pytest.mark.parametrize("group", ["preprocessing", "window", "perception", "axes", "selection", "boxes", "maps"])
def test_every_field_of_the_rules_is_compared(group, manifest, tiny_model, graphs):
    """The reader refuses most other values. A later version may have several."""
    rules = getattr(manifest, group)
    for name in type(rules).model_fields:
        changed = manifest.model_copy(update={group: rules.model_copy(update={name: "another"})})
        differences = manifest_differences(changed, tiny_model, graphs, OperatorForms())
        assert [difference.field for difference in differences] == [f"{group}.{name}"]


def test_the_versions_of_packages_and_the_parity_report_are_not_compared(manifest, tiny_model, graphs):
    other = manifest.model_copy(update={"versions": {"torch": "1.0"}, "parity": None})
    assert manifest_differences(other, tiny_model, graphs, OperatorForms()) == []


def test_weights_of_another_seed_are_a_difference(manifest):
    other = randomise(DuoSpaceNet(PRESETS["tiny"]), seed=1).eval()
    differences = manifest_differences(manifest, other, graphs_to_export(other), OperatorForms())
    assert [difference.field for difference in differences] == ["weights.sha256"]


def test_control_characters_of_the_manifest_are_escaped(manifest, tiny_model, graphs):
    changed = manifest.model_copy(update={"config": manifest.config | {"\x1b[2J": "\x1b[2J"}})
    (difference,) = manifest_differences(changed, tiny_model, graphs, OperatorForms())
    assert str(difference) == r"manifest.json: field config.\x1b[2J: expected nothing; got '\x1b[2J'"
