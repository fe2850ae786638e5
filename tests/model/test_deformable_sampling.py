"""Deformable sampling around locations in several cameras, against a loop over its equation."""

import pytest
import torch

from duospacenet.model.deformable_sampling import deformable_sampling, sample_and_sum, sample_frames_together
from tests.helpers.deformable_sampling_loop import SamplingInputs, random_inputs, sample_by_loop
from tests.helpers.model_inputs import assert_close

ONE_LEVEL = [(5, 7)]
FOUR_LEVELS = [(5, 7), (3, 4), (2, 2), (1, 3)]

CASES = {
    "one of everything": random_inputs(ONE_LEVEL, num_cameras=1),
    "two heads": random_inputs(ONE_LEVEL, num_heads=2, seed=1),
    "three points": random_inputs(ONE_LEVEL, num_points=3, seed=2),
    "six cameras": random_inputs(ONE_LEVEL, num_cameras=6, num_queries=30, seed=3),
    "PV attention": random_inputs(FOUR_LEVELS, 2, 3, num_queries=20, num_heads=4, num_points=2, seed=4),
    "BEV attention": random_inputs(ONE_LEVEL, 3, 1, num_queries=20, num_heads=2, num_points=4, seed=5),
    "lifting": random_inputs(FOUR_LEVELS, num_queries=40, has_offsets=False, has_weights=False, seed=6),
    "no weights": random_inputs(FOUR_LEVELS, num_heads=2, num_points=2, has_weights=False, seed=7),
    "no offsets": random_inputs(FOUR_LEVELS, has_offsets=False, seed=8),
    "a single pixel": random_inputs([(1, 1)], num_cameras=4, seed=9),
}


# --- The equation -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_the_formula_equals_the_loop(name):
    assert_close(sample_and_sum(*CASES[name]), sample_by_loop(CASES[name]), 1e-12)


@pytest.mark.parametrize("name", CASES)
def test_the_form_for_gpus_equals_the_loop(name):
    assert_close(sample_frames_together(*CASES[name]), sample_by_loop(CASES[name]), 1e-12)


@pytest.mark.parametrize("name", CASES)
def test_the_operator_equals_the_formula_bit_for_bit(name):
    inputs = CASES[name].to(torch.float32)
    assert torch.equal(deformable_sampling(*inputs), sample_and_sum(*inputs))


def test_the_cases_have_locations_in_no_camera_in_one_and_in_several():
    counts = {int(n) for inputs in CASES.values() for n in inputs.visible.sum(dim=1).unique()}
    assert {0, 1, 2, 3, 4} <= counts


@pytest.mark.parametrize("name", CASES)
def test_in_float32_the_formula_is_exact_to_the_rounding_of_positions(name):
    inputs = CASES[name].to(torch.float32)
    assert_close(sample_and_sum(*inputs), sample_by_loop(inputs), 1e-5)


@pytest.mark.parametrize("num_queries", [1, 2, 13, 97])
def test_any_number_of_queries(num_queries):
    inputs = random_inputs(FOUR_LEVELS, 2, 6, num_queries, num_heads=2, num_points=2, seed=12)
    assert_close(sample_and_sum(*inputs), sample_by_loop(inputs), 1e-12)


def test_the_order_of_the_cameras_does_not_matter():
    inputs = CASES["PV attention"]
    order = [2, 0, 1]
    shuffled = inputs._replace(
        values=[level[order] for level in inputs.values],
        locations=inputs.locations[:, order],
        visible=inputs.visible[:, order],
    )
    assert_close(sample_and_sum(*shuffled), sample_and_sum(*inputs), 1e-12)


def test_a_location_that_is_visible_in_no_camera_gives_exactly_zero():
    inputs = CASES["PV attention"]
    inputs = inputs._replace(visible=torch.zeros_like(inputs.visible))
    assert sample_and_sum(*inputs).eq(0).all()


def test_the_location_and_the_features_of_a_camera_without_the_point_have_no_effect():
    inputs = CASES["PV attention"]
    inputs = inputs._replace(visible=inputs.visible.clone())
    inputs.visible[:, 1] = False
    expected = sample_and_sum(*inputs)
    locations, values = inputs.locations.clone(), [level.clone() for level in inputs.values]
    locations[:, 1] = -1e30
    for level in values:
        level[1] = torch.nan
    assert torch.equal(sample_and_sum(*inputs._replace(locations=locations, values=values)), expected)


def test_a_frame_of_nan_in_which_nothing_is_visible_is_zero_and_does_not_change_the_others():
    """An empty slot of the window holds NaN in its values and locations."""
    inputs = CASES["PV attention"]
    inputs = inputs._replace(visible=inputs.visible.clone())
    inputs.visible[1] = False
    expected = sample_by_loop(inputs)
    locations, values = inputs.locations.clone(), [level.clone() for level in inputs.values]
    locations[1] = torch.nan
    for level in values[len(FOUR_LEVELS) :]:
        level.fill_(torch.nan)
    result = sample_and_sum(*inputs._replace(locations=locations, values=values))
    assert result[1].eq(0).all()
    assert_close(result[0], expected[0], 1e-12)


# --- Borders ------------------------------------------------------------------------------------------------------


def at_centre_of_the_middle_camera(dtype, offset):
    """Three cameras of 2×4 ones, tens and hundreds. The location is the centre of the second camera's image."""
    camera = torch.ones(1, 1, 2, 4, dtype=dtype)
    return SamplingInputs(
        values=[torch.cat((camera, 10 * camera, 100 * camera))],
        locations=torch.full((1, 3, 2, 1), 0.5, dtype=dtype),
        visible=torch.tensor([[[False], [True], [False]]]),
        offsets=torch.tensor(offset, dtype=dtype).reshape(1, 1, 1, 1, 1, 2),
        weights=torch.ones(1, 1, 1, 1, 1, dtype=dtype),
        num_heads=1,
    )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    ("offset", "expected"),
    [
        ((0.0, 0.0), 10.0),
        ((0.0, 0.5), 10.0),  # the centre of the second row
        ((0.0, 1.0), 5.0),  # the lower border: half of the second row
        ((0.0, -1.0), 5.0),
        ((0.0, 1.5), 0.0),  # a whole cell from the last centre
        ((0.0, 3.0), 0.0),
        ((0.0, -1.5), 0.0),
        ((0.0, -3.0), 0.0),
        ((2.0, 0.0), 5.0),  # the right border
        ((-2.0, 0.0), 5.0),
        ((2.5, 0.0), 0.0),
        ((-2.5, 0.0), 0.0),
        ((3.0, 3.0), 0.0),
        ((1e30, 0.0), 0.0),
        ((-1e30, 0.0), 0.0),
        ((0.0, 1e30), 0.0),
        ((0.0, -1e30), 0.0),
    ],
)
def test_samples_beyond_a_border_are_zero_and_do_not_come_from_another_camera(dtype, offset, expected):
    assert sample_and_sum(*at_centre_of_the_middle_camera(dtype, offset)).item() == expected


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("half_images", [0, 1, 2, 3, 5, 10, 30, 1e2, 1e3, 1e4, 1e5])
def test_no_offset_leads_from_a_camera_without_the_location_into_its_image(half_images, sign):
    """The image has 2×4 cells. The offset is as many halves of the width along x as halves of the height along y."""
    inputs = at_centre_of_the_middle_camera(torch.float32, (sign * half_images * 2, sign * half_images))
    inputs = inputs._replace(visible=torch.zeros_like(inputs.visible))
    assert sample_and_sum(*inputs).eq(0).all()


@pytest.mark.parametrize("offset", [(1e6, 0.0), (-1e6, 0.0), (0.0, 1e6), (0.0, -1e6), (2.1, 0.0), (0.0, -2.1)])
@pytest.mark.parametrize("rows", [1, 3, 7, 54])
def test_samples_outside_a_single_camera_are_exactly_zero(offset, rows):
    for dtype in (torch.float32, torch.float64):
        inputs = SamplingInputs(
            values=[torch.ones(1, 1, rows, 3, dtype=dtype)],
            locations=torch.tensor([0.0 if each <= 0 else 1.0 for each in offset], dtype=dtype).reshape(1, 1, 2, 1),
            visible=torch.tensor([[[True]]]),
            offsets=torch.tensor(offset, dtype=dtype).reshape(1, 1, 1, 1, 1, 2),
            weights=None,
            num_heads=1,
        )
        assert sample_and_sum(*inputs).eq(0).all()


# --- The operator -------------------------------------------------------------------------------------------------


def tensors_of(inputs):
    """The tensors that can have a gradient."""
    return [*inputs.values, inputs.locations, *(each for each in (inputs.offsets, inputs.weights) if each is not None)]


def with_gradients(inputs):
    """A copy of the inputs whose numbers require a gradient."""
    copy = inputs.to(torch.float64)._replace(values=[level.clone() for level in inputs.values])
    names = [name for name in ("locations", "offsets", "weights") if getattr(inputs, name) is not None]
    copy = copy._replace(**{name: getattr(inputs, name).clone() for name in names})
    for tensor in tensors_of(copy):
        tensor.requires_grad_()
    return copy


@pytest.mark.parametrize("name", CASES)
def test_the_gradients_of_the_operator_are_those_of_the_formula(name):
    gradients = []
    for function in (deformable_sampling, sample_and_sum):
        inputs = with_gradients(CASES[name])
        function(*inputs).square().sum().backward()
        gradients.append([tensor.grad for tensor in tensors_of(inputs)])
    for ours, expected in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, expected, rtol=1e-12, atol=1e-12)
    assert all(gradient.any() for gradient in gradients[0][: len(CASES[name].values)])


def test_the_gradients_are_the_differences_of_the_operator():
    inputs = with_gradients(
        random_inputs([(4, 5), (2, 3)], num_cameras=2, num_queries=3, num_heads=2, num_points=2, seed=11)
    )
    num_values = len(inputs.values)

    def sampled(*tensors):
        values, (locations, offsets, weights) = list(tensors[:num_values]), tensors[num_values:]
        return deformable_sampling(values, locations, inputs.visible, offsets, weights, inputs.num_heads)

    assert torch.autograd.gradcheck(sampled, tuple(tensors_of(inputs)), fast_mode=True)


@pytest.mark.parametrize("needed", [("values",), ("weights",), ("offsets", "locations")])
def test_only_the_inputs_that_require_a_gradient_get_one(needed):
    """The values of past frames require none."""
    both = with_gradients(CASES["PV attention"])
    some = with_gradients(CASES["PV attention"])
    for name in {"values", "locations", "offsets", "weights"} - set(needed):
        for tensor in some.values if name == "values" else [getattr(some, name)]:
            tensor.requires_grad_(False)
    if "values" in needed:
        some.values[1].requires_grad_(False)
    for inputs in (both, some):
        deformable_sampling(*inputs).square().sum().backward()
    for tensor, other in zip(tensors_of(some), tensors_of(both), strict=True):
        if tensor.requires_grad:
            torch.testing.assert_close(tensor.grad, other.grad, rtol=1e-12, atol=1e-12)
        else:
            assert tensor.grad is None


@pytest.mark.parametrize("name", ["PV attention", "lifting"])
def test_the_operator_is_registered_as_torch_requires(name):
    """torch checks the schema, the shapes on the meta device, and that no input is changed."""
    checks = ("test_schema", "test_autograd_registration", "test_faketensor")
    torch.library.opcheck(deformable_sampling, tuple(with_gradients(CASES[name])), test_utils=checks)
