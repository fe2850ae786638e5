"""Modulated deformable convolution against its equation, point by point, and its derivatives."""

import pytest
import torch
import torch.nn.functional as F

from duospacenet.model.backbones.deformable_convolution import DeformableConvolution, deformable_convolution
from tests.helpers import references
from tests.helpers.model_inputs import assert_close, normal, with_random_weights


def random_offsets_and_masks(height, width, stride, spread_px, seed=0):
    """Random offsets (1, 18, H', W') with the standard deviation `spread_px`, and masks (1, 9, H', W')."""
    size = -(-height // stride), -(-width // stride)
    return spread_px * normal(1, 18, *size, seed=seed), normal(1, 9, *size, seed=seed + 1).sigmoid()


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("size", [(7, 10), (6, 5), (1, 4), (1, 1)])
def test_the_module_equals_the_equation(stride, size):
    module = with_random_weights(DeformableConvolution(5, 4, stride)).double()
    x = normal(2, 5, *size, seed=1).double()
    actual = module(x)
    for n in range(2):
        expected = references.deformable_convolution(references.weights_of(module), x[n].numpy(), stride)
        assert_close(actual[n], expected, 1e-12)


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("spread_px", [0.3, 3, 30, 3e5])
def test_offsets_of_any_size_equal_the_equation(stride, spread_px):
    """With large offsets nearly all points are far outside. One point is kept inside."""
    x, kernel = normal(1, 3, 7, 9, seed=1), normal(4, 3, 3, 3, seed=2)
    offsets, masks = random_offsets_and_masks(7, 9, stride, spread_px)
    offsets[:, 8:10] = 0.25
    actual = deformable_convolution(*(tensor.double() for tensor in (x, kernel, offsets, masks)), stride)
    expected = references.modulated_sum(
        *(tensor.double().numpy() for tensor in (kernel, x[0], offsets[0], masks[0])), stride
    )
    assert_close(actual[0], expected, 1e-12)
    assert_close(deformable_convolution(x, kernel, offsets, masks, stride)[0], expected, 1e-5)


@pytest.mark.parametrize(
    ("row", "share"), [(-2, 0), (-1, 0), (-0.75, 0.25), (0, 1), (3, 1), (3.25, 0.75), (4, 0), (5, 0)]
)
def test_towards_the_border_a_sample_fades_to_zero_over_one_pixel(row, share):
    """By hand: x is 1 everywhere, only the centre of the kernel is not 0, and it samples `row` of 4."""
    kernel = torch.zeros(1, 1, 3, 3)
    kernel[..., 1, 1] = 1
    offsets = torch.zeros(1, 18, 4, 4)
    offsets[:, 8] = row - torch.arange(4.0)[:, None]
    assert torch.allclose(
        deformable_convolution(torch.ones(1, 1, 4, 4), kernel, offsets, torch.ones(1, 9, 4, 4), 1),
        torch.full((1, 1, 4, 4), float(share)),
        atol=1e-6,
    )


def test_each_mask_weights_its_own_point():
    """By hand: point k of the kernel is 2^k, so the sum shows which masks were used."""
    kernel = (2.0 ** torch.arange(9)).reshape(1, 1, 3, 3)
    masks = torch.zeros(1, 9, 3, 3)
    masks[:, [1, 3, 8]] = torch.tensor([1.0, 0.5, 1.0]).reshape(1, 3, 1, 1)
    y = deformable_convolution(torch.ones(1, 1, 3, 3), kernel, torch.zeros(1, 18, 3, 3), masks, 1)
    assert torch.allclose(y[0, 0, 1, 1], torch.tensor(2 + 0.5 * 8 + 256))


@pytest.mark.parametrize("stride", [1, 2])
def test_the_initial_result_is_half_that_of_a_normal_convolution(stride):
    module, x = DeformableConvolution(5, 4, stride).double(), normal(2, 5, 7, 9, seed=1).double()
    assert_close(module(x), 0.5 * F.conv2d(x, module.weight, stride=stride, padding=1).detach(), 1e-12)


@pytest.mark.parametrize("stride", [1, 2])
def test_the_gradients_are_those_of_the_function(stride):
    offsets, masks = random_offsets_and_masks(4, 5, stride, spread_px=1.5)
    tensors = normal(1, 2, 4, 5, seed=2), normal(3, 2, 3, 3, seed=3), offsets, masks
    tensors = tuple(tensor.double().requires_grad_() for tensor in tensors)
    assert torch.autograd.gradcheck(lambda *given: deformable_convolution(*given, stride), tensors)


def test_a_frozen_input_gets_no_gradient_and_does_not_change_the_others():
    offsets, masks = random_offsets_and_masks(4, 5, 1, spread_px=1.5)
    x, kernel = normal(1, 2, 4, 5, seed=2), normal(3, 2, 3, 3, seed=3)
    gradients = []
    for frozen in (False, True):
        x.requires_grad_(not frozen)
        weight = kernel.clone().requires_grad_()
        deformable_convolution(x, weight, offsets, masks, 1).square().sum().backward()
        gradients.append(weight.grad)
    assert gradients[0].abs().min() > 0
    assert torch.equal(*gradients)


def test_every_parameter_has_a_gradient():
    module = with_random_weights(DeformableConvolution(3, 4))
    module(normal(1, 3, 6, 7, seed=1)).square().sum().backward()
    assert all(parameter.grad.abs().min() > 0 for parameter in module.parameters())


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_in_mixed_precision_it_computes_in_float32(dtype):
    """The input and the offsets have the lower precision there, and the kernel has not."""
    offsets, masks = random_offsets_and_masks(4, 5, 1, spread_px=1.5)
    rounded = [tensor.to(dtype).requires_grad_() for tensor in (normal(1, 2, 4, 5, seed=2), offsets, masks)]
    (x, *points), kernel = rounded, normal(3, 2, 3, 3, seed=3).requires_grad_()
    with torch.autocast("cpu", dtype):
        mixed = deformable_convolution(x, kernel, *points, 1)
    expected = deformable_convolution(x.float(), kernel, *(tensor.float() for tensor in points), 1)
    assert torch.equal(mixed, expected)
    inputs = [*rounded, kernel]
    pairs = zip(*(torch.autograd.grad(y.square().sum(), inputs) for y in (mixed, expected)), strict=True)
    assert all(torch.equal(*pair) for pair in pairs)


@pytest.mark.parametrize("stride", [1, 2])
def test_it_passes_torchs_operator_check(stride):
    offsets, masks = random_offsets_and_masks(5, 7, stride, spread_px=1.5)
    tensors = normal(2, 2, 5, 7, seed=2), normal(3, 2, 3, 3, seed=3).requires_grad_(), offsets, masks
    tensors = tensors[0], tensors[1], *(tensor.expand(2, -1, -1, -1) for tensor in tensors[2:])
    torch.library.opcheck(torch.ops.duospacenet.deformable_convolution.default, (*tensors, stride))


@pytest.mark.parametrize(("stride", "size"), [(1, (7, 9)), (2, (4, 5))])
def test_it_can_be_built_and_run_on_the_meta_device(stride, size):
    with torch.device("meta"):
        y = DeformableConvolution(5, 4, stride)(torch.empty(2, 5, 7, 9))
    assert y.device.type == "meta"
    assert y.shape == (2, 4, *size)
