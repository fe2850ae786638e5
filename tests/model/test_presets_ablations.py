"""Each row of the paper's ablation tables is a preset that can be trained. tests/export tests their export."""

import pytest
import torch

from benchmarks.ablation_tables import ABLATION_TABLES, ablation_presets
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.bev_encoder import FeatureDivergenceEnhancement
from duospacenet.model.presets import ABLATIONS
from tests.helpers.model_inputs import random_images, random_window


def test_the_tables_hold_every_ablation_and_no_other():
    assert {row for table in ABLATION_TABLES.values() for row in table} == {"", *ABLATIONS}


@pytest.mark.parametrize("size", ["tiny", "nano", "small"])
def test_every_row_of_the_tables_is_a_preset_by_name(size):
    for row in ABLATIONS:
        assert PRESETS[f"{size}-{row}"].preset == f"{size}-{row}"


@pytest.fixture(scope="module")
def models():
    return {name: randomise(DuoSpaceNet(PRESETS[name])) for name in ablation_presets("tiny")}


def attends_to(model, space):
    return any(f"cross_attention.{space}." in name for name in model.state_dict())


@pytest.mark.parametrize(
    ("row", "bev", "pv", "maps"), [("bev-no-fde", True, False, 2), ("pv", False, True, 0), ("no-fde", True, True, 2)]
)
def test_the_rows_on_duo_space_features_differ_in_the_spaces(models, row, bev, pv, maps):
    """Queries attend to BEV, to PV, or to both. The model lacks unused parts."""
    model = models[f"tiny-{row}"]
    assert (attends_to(model, "bev"), attends_to(model, "pv")) == (bev, pv)
    assert any(name.startswith("lifter.") for name in model.state_dict()) == (row != "pv")
    assert len(getattr(getattr(model, "segmentation", None), "heads", ())) == maps


@pytest.mark.parametrize(("row", "enhanced"), [("bev-no-fde", False), ("bev", True), ("no-fde", False), ("", True)])
def test_the_rows_on_feature_divergence_enhancement_differ_in_fde(models, row, enhanced):
    """FDE has three Conv3D and three Conv2D. Without FDE there is one linear layer."""
    part = models[f"tiny-{row}".removesuffix("-")].divergence_enhancement
    kinds = [type(module).__name__ for module in part.modules() if "Conv" in type(module).__name__]
    assert kinds == (["Conv3d"] * 3 + ["Conv2d"] * 3 if enhanced else ["Conv2d"])
    assert isinstance(part, FeatureDivergenceEnhancement) == enhanced


@pytest.mark.parametrize(("row", "contents"), [("unshared", 1), ("shared-content", 1), ("", 2)])
def test_the_rows_on_duo_space_queries_differ_in_the_content(models, row, contents):
    model = models[f"tiny-{row}".removesuffix("-")]
    assert tuple(model.queries.content.shape) == (32, contents * 32)
    assert attends_to(model, "bev")
    assert attends_to(model, "pv")


def test_each_set_of_unshared_queries_attends_to_one_space(models):
    """Other PV values change the second half of the queries only. The first half attends to BEV."""
    model = models["tiny-unshared"]
    attention, window = model.decoder.layers[0].cross_attention, random_window(model.config, 4)
    with torch.no_grad():
        caches = [model.cache_frame(model.encode(*frame)) for frame in frames_of(model.config, window)]
        content, pose = model.queries()
        before = attended(model, attention, content, pose, caches, window)
        other = [frame._replace(pv=[[2 * level for level in layer] for layer in frame.pv]) for frame in caches]
        after = attended(model, attention, content, pose, other, window)
    changed = (after != before).any(dim=-1)
    assert not changed[:16].any()
    assert changed[16:].any()


@pytest.mark.parametrize(("row", "left"), [("stacking", 1), ("attention", 1), ("", 2)])
def test_the_rows_on_temporal_strategies_differ_in_the_cached_values(models, row, left):
    """Temporal queries cache the BEV values of each layer, a fusion caches the BEV features. All cache PV values."""
    model = models[f"tiny-{row}".removesuffix("-")]
    window = random_window(model.config, 4)
    with torch.no_grad():
        caches = model.cache_frame(model.encode(*next(iter(frames_of(model.config, window)))))
    assert (len(caches.bev), len(caches.pv)) == (left, 2)


@pytest.mark.parametrize("name", ablation_presets("tiny"))
def test_every_row_can_be_trained(models, name):
    """Every parameter has a gradient, and a small step against it lowers the loss."""
    model, window = models[name].train(), random_window(PRESETS[name], 4)
    images = random_images(model.config, 4)

    before = loss_of(model(images, *window))
    before.backward()
    idle = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.isfinite().all()]
    idle += [name for name, p in model.named_parameters() if p.grad is not None and not p.grad.any()]
    assert not idle
    squares = sum(float((p.grad**2).sum()) for p in model.parameters())
    with torch.no_grad():
        for parameter in model.parameters():
            parameter -= 1e-3 * float(before) / squares * parameter.grad
        after = loss_of(model(images, *window))
    assert after < before


def loss_of(output):
    poses = sum(p.pose.square().mean() + p.class_logits.square().mean() for p in output.predictions)
    return poses + sum(mask.square().mean() for mask in output.maps.values())


def frames_of(config, window):
    return zip(random_images(config, 4), window.image_T_ego, window.camera_valid, strict=True)


def attended(model, attention, content, pose, caches, window):
    """The output of the cross-attention in the first layer."""
    outputs = []
    handle = attention.register_forward_hook(lambda _module, _inputs, output: outputs.append(output))
    model.decoder(content, pose, caches, window)
    handle.remove()
    return outputs[0]
