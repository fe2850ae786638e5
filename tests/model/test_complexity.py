"""Counts of operations, against small modules counted by hand, an independent formula for one part, and the paper."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from duospacenet.model import PRESETS
from duospacenet.model.attention import SelfAttention
from duospacenet.model.backbones.deformable_convolution import DeformableConvolution
from duospacenet.model.complexity import Flops, complexity_by_part, count_flops, count_parameters

BASE, TINY = PRESETS["base"], PRESETS["tiny"]


def flops(module, *shapes) -> Flops:
    with torch.device("meta"):
        return count_flops(module.to("meta"), tuple(torch.zeros(shape) for shape in shapes), {})["total"]


class Sampling(nn.Module):
    def forward(self, features, grid):
        return F.grid_sample(features, grid, align_corners=False)


# --- Small modules ------------------------------------------------------------------------------------------------


def test_a_convolution_has_two_operations_per_weight_and_output_position():
    """4×5 output positions, 7 output channels, 3 input channels, 3×3 points; stride 2 on 8×10."""
    expected = 2 * (4 * 5) * 7 * 3 * 9
    assert flops(nn.Conv2d(3, 7, 3, stride=2, padding=1), (1, 3, 8, 10)) == (expected, expected)


def test_a_3d_convolution_is_counted_in_the_same_way():
    expected = 2 * (2 * 4 * 5) * 7 * 3 * 27
    assert flops(nn.Conv3d(3, 7, 3, padding=1), (1, 3, 2, 4, 5)) == (expected, expected)


def test_a_linear_layer_has_two_operations_per_weight_and_row():
    assert flops(nn.Linear(6, 11), (5, 6)) == (2 * 5 * 6 * 11,) * 2


def test_self_attention_has_its_linear_layers_and_two_matrix_products_per_head():
    """5 queries, 12 channels, 3 heads of 4. Linear layers 12 to 36 and 12 to 12; two products of 5×5×4 per head."""
    expected = 2 * (5 * 12 * 36 + 5 * 12 * 12 + 3 * (5 * 5 * 4) + 3 * (5 * 5 * 4))
    assert flops(SelfAttention(12, 3), (5, 12)) == (expected, expected)


def test_sampling_has_four_multiply_adds_per_number_and_is_not_in_the_papers_count():
    assert flops(Sampling(), (2, 6, 8, 9), (2, 3, 5, 2)) == (0, 2 * 4 * (2 * 6 * 3 * 5))


def test_the_papers_count_of_a_deformable_convolution_has_the_offsets_only():
    """Two images, 4×5 output positions; 27 offset channels; 9 samples of 3 channels; 7 output channels."""
    places = 2 * 4 * 5
    offsets, samples, kernel = 2 * places * 27 * 3 * 9, 2 * 4 * places * 9 * 3, 2 * places * 7 * 3 * 9
    got = flops(DeformableConvolution(3, 7, stride=2), (2, 3, 8, 10))
    assert got == (offsets, offsets + samples + kernel)


def test_normalisation_and_activation_are_not_counted():
    assert flops(nn.Sequential(nn.BatchNorm2d(3).eval(), nn.ReLU()), (1, 3, 8, 8)) == (0, 0)


def test_nested_calls_within_a_part_are_counted_once():
    class Twice(nn.Module):
        def __init__(self):
            super().__init__()
            self.part = nn.Sequential(nn.Linear(3, 3, bias=False))
            self.other = nn.Linear(3, 3, bias=False)

        def forward(self, x):
            return self.other(self.part(x)) + self.part[0](x)

    model = Twice().to("meta")
    counted = count_flops(model, (torch.zeros(1, 3, device="meta"),), {"part": [model.part], "none": []})
    assert counted == {"part": (36, 36), "none": (0, 0), "total": (54, 54)}
    assert not any(module._forward_hooks or module._forward_pre_hooks for module in model.modules())


def test_running_statistics_are_not_parameters():
    assert count_parameters([nn.Conv2d(3, 7, 3), nn.BatchNorm2d(7)]) == 3 * 7 * 9 + 7 + 7 + 7


# --- The model ----------------------------------------------------------------------------------------------------


def test_the_counts_are_within_3_percent_of_the_papers():
    """Paper, complexity table: DuoSpaceNet with one frame has 64.8 M parameters and 1771.7 GFLOPs."""
    total = complexity_by_part(BASE)["total"]
    assert total.parameters == pytest.approx(64.8e6, rel=0.03)
    assert total.flops == pytest.approx(1771.7e9, rel=0.03)
    assert total.flops_with_sampling > 1.3 * total.flops


def test_the_divergence_enhancement_has_six_convolutions():
    """200×200×4 voxels, 64 channels: three 3×3×3 convolutions. Flattened: three 3×3 convolutions, 256 channels."""
    fde = complexity_by_part(BASE)["FDE"]
    weights_3d, weights_2d = 3 * 64 * 64 * 27, 3 * 256 * 256 * 9
    assert fde.parameters == weights_3d + weights_2d + 2 * (
        3 * 64 + 3 * 256
    )  # plus the scale and shift of each BatchNorm
    assert fde.flops == fde.flops_with_sampling == 2 * 200 * 200 * (4 * weights_3d + weights_2d)


def test_the_lifter_reduces_every_level_and_samples_it_at_every_voxel():
    """Six 1600×640 images, strides 8 to 64, 256 to 64 channels. The projection is element-wise and is not counted."""
    cells, voxels = 200 * 80 + 100 * 40 + 50 * 20 + 25 * 10, 200 * 200 * 4
    lifter = complexity_by_part(BASE)["lifter"]
    assert lifter.parameters == 256 * 64
    assert lifter.flops == 2 * 6 * cells * 256 * 64
    assert lifter.flops_with_sampling - lifter.flops == 8 * 6 * 4 * 64 * voxels


@pytest.mark.parametrize("num_frames", [1, 3])
def test_every_query_samples_every_frame_in_bev_and_in_all_cameras(num_frames):
    """Per layer and frame: 900 queries, 256 channels, 16 points in BEV, and in 6 cameras 4 points on 4 levels."""
    decoder = complexity_by_part(BASE, num_frames)["decoder"]
    points = 16 + 6 * 4 * 4
    assert (BASE.bev_points, BASE.pv_points, BASE.num_queries, BASE.num_layers) == (16, 4, 900, 4)
    assert decoder.flops_with_sampling - decoder.flops == 8 * 4 * num_frames * 900 * 256 * points


@pytest.mark.parametrize("num_frames", [1, 3])
def test_the_parts_add_up_to_the_total(num_frames):
    *parts, total = complexity_by_part(TINY, num_frames).values()
    assert [sum(column) for column in zip(*parts, strict=True)] == list(total)


def test_every_frame_of_a_window_is_encoded():
    one, three = complexity_by_part(TINY), complexity_by_part(TINY, 3)
    for part in ("encoder", "lifter", "FDE"):
        assert three[part].flops == 3 * one[part].flops
        assert three[part].parameters == one[part].parameters
    assert one["decoder"].flops < three["decoder"].flops < 3 * one["decoder"].flops
    assert three["segmentation"] == one["segmentation"]


def test_wider_queries_change_the_decoder_only():
    few, many = complexity_by_part(TINY), complexity_by_part(replace(TINY, num_queries=64))
    assert few["decoder"].flops < many["decoder"].flops
    assert {name for name in few if few[name] != many[name]} == {"decoder", "total"}
