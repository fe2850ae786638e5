"""Both ONNX forms of deformable sampling in onnxruntime, against a loop over the equation."""

import functools
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
import onnx
import pytest
import torch
from torch import Tensor, nn

from duospacenet.export.graphs import Graph
from duospacenet.export.operator_forms import OperatorForms
from duospacenet.export.sampling_forms import OutputGrid
from duospacenet.export.tracing import trace
from duospacenet.model.deformable_sampling import deformable_sampling
from duospacenet.runtime.bundle.manifest import AttentionForm
from tests.helpers.deformable_sampling_loop import SamplingInputs, random_inputs, sample_by_loop
from tests.helpers.exports import session_on_pool
from tests.helpers.model_inputs import assert_close

FORMS = get_args(AttentionForm)
FOUR_LEVELS = [(5, 7), (3, 4), (2, 2), (1, 3)]
CASES = {
    "PV attention": random_inputs([(5, 7), (3, 4)], 2, 6, num_queries=32, num_heads=4, num_points=2, seed=1),
    "BEV attention": random_inputs([(9, 6)], 4, 1, num_queries=32, num_heads=2, num_points=4, seed=2),
    "lifting": random_inputs(FOUR_LEVELS, 1, 6, num_queries=96, has_offsets=False, has_weights=False, seed=3),
    "one query": random_inputs(FOUR_LEVELS, 1, 6, num_queries=1, num_heads=2, num_points=2, seed=4),
    "two queries": random_inputs([(5, 7)], 4, 1, num_queries=2, has_offsets=False, has_weights=False, seed=5),
    "seven queries": random_inputs([(5, 7), (3, 4)], 1, 6, num_queries=7, has_offsets=False, seed=6),
    "97 queries": random_inputs([(4, 15)], 1, 3, num_queries=97, num_heads=2, seed=7),
    "rows smaller than the kernel": random_inputs([(2, 3), (1, 1)], 1, 1, num_queries=6, num_points=5, seed=9),
    "columns smaller than the kernel": random_inputs([(1, 1)], 1, 6, num_queries=6, num_points=2, seed=10),
}


class _Sampling(nn.Module):
    """Deformable sampling of named tensors."""

    def __init__(self, inputs: SamplingInputs) -> None:
        super().__init__()
        self.inputs = inputs
        self.names = list(inputs.tensors())

    def forward(self, *tensors: Tensor) -> Tensor:
        return deformable_sampling(*self.inputs.with_tensors(dict(zip(self.names, tensors, strict=True))))


class Traced(NamedTuple):
    """The inputs of a case in float32, and a file per form."""

    inputs: SamplingInputs
    files: dict[str, Path]


@pytest.fixture(scope="module")
def trace_case(tmp_path_factory) -> Callable[[str], Traced]:
    """Traces a case once: in the form for onnxruntime, and PV attention in the portable form too."""

    @functools.cache
    def trace_once(name: str) -> Traced:
        inputs, folder = CASES[name].to(torch.float32), tmp_path_factory.mktemp("graphs")
        forms = FORMS if name == "PV attention" else ("deform-conv",)
        module, files = _Sampling(inputs), {form: folder / f"{form}.onnx" for form in forms}
        graph = Graph("decoder", module, inputs.tensors(), {"sums": module(*inputs.tensors().values())})
        for form, file in files.items():
            trace(graph, file, OperatorForms(attention=form))
        return Traced(inputs, files)

    return trace_once


@pytest.fixture(params=CASES)
def traced(request, trace_case) -> Traced:
    return trace_case(request.param)


@pytest.fixture
def pv_attention(trace_case) -> Traced:
    """Two frames and six cameras, in both forms."""
    return trace_case("PV attention")


def run(file: Path, inputs: SamplingInputs) -> Tensor:
    arrays = {name: tensor.numpy() for name, tensor in inputs.tensors().items()}
    return torch.from_numpy(session_on_pool(file).run(None, arrays)[0])


# --- The equation -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("most_visible", range(7))
def test_a_graph_equals_the_loop_for_any_number_of_cameras_that_see_a_location(traced, most_visible):
    """A location is visible in at most this many cameras, and one location is visible in exactly as many."""
    visible = visible_in(traced.inputs.visible.shape, most_visible)
    inputs = traced.inputs._replace(visible=visible)
    expected = sample_by_loop(inputs)
    for form, file in traced.files.items():
        result = run(file, inputs)
        if most_visible == 0:
            assert torch.equal(result, torch.zeros(expected.shape)), form
        else:
            assert_close(result, expected, 1e-4)


def visible_in(shape: tuple[int, ...], most: int) -> Tensor:
    """A random mask (T, N, Q) with at most `most` cameras per location, and as many for the first one."""
    num_frames, num_cameras, num_queries = shape
    rng, visible = np.random.default_rng(most), np.zeros(shape, dtype=bool)
    for t, q in np.ndindex(num_frames, num_queries):
        count = most if t == q == 0 else rng.integers(most + 1)
        visible[t, rng.permutation(num_cameras)[:count], q] = True
    return torch.tensor(visible)


def test_the_graphs_have_one_operator_per_level_and_frame(traced):
    """The form for onnxruntime has no GridSample, and the portable form no DeformConv."""
    for form, file in traced.files.items():
        operators = [node.op_type for node in onnx.load(file).graph.node]
        present, absent = ("DeformConv", "GridSample") if form == "deform-conv" else ("GridSample", "DeformConv")
        assert operators.count(present) == len(traced.inputs.values)
        assert absent not in operators


@pytest.mark.parametrize(
    "offset", [(1e30, 0), (-1e30, 0), (0, 1e30), (0, -1e30), (1e5, 1e5), (7.6, 0), (-7.6, 0), (0, 5.6), (0, -5.6)]
)
def test_samples_outside_a_camera_are_zero(pv_attention, offset):
    """The largest image has 5×7 cells. With the row of zeros, 5.6 rows below may be inside the next camera's image."""
    inputs = pv_attention.inputs
    offsets = torch.tensor(offset, dtype=torch.float32)[:, None].expand(inputs.offsets.shape)
    inputs = inputs._replace(
        offsets=offsets.contiguous(),
        visible=torch.ones_like(inputs.visible),
        values=[torch.where(value == 0, value, 1.0) for value in inputs.values],
    )
    for form, file in pv_attention.files.items():
        assert run(file, inputs).abs().max() < 1e-4, form


# --- An empty slot ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("empty", [0, 1])
def test_an_invisible_frame_of_nan_does_not_change_the_other(pv_attention, empty):
    """An empty slot of the window holds NaN everywhere. Nothing is visible in it."""
    inputs = pv_attention.inputs._replace(visible=pv_attention.inputs.visible.clone())
    inputs.visible[empty] = False
    other = 1 - empty
    expected = sample_by_loop(inputs)[other]
    broken = {name: tensor.clone() for name, tensor in inputs.tensors().items()}
    for name in ("locations", "offsets", "weights"):
        broken[name][empty] = torch.nan
    num_levels = len(inputs.values) // 2
    for i in range(empty * num_levels, (empty + 1) * num_levels):
        broken[f"value_{i}"].fill_(torch.nan)
    for file in pv_attention.files.values():
        assert_close(run(file, inputs.with_tensors(broken))[other], expected, 1e-4)


# --- The output grid ----------------------------------------------------------------------------------------------


def test_twelve_queries_with_two_points_and_three_cameras_are_six_rows_of_two():
    """By hand: a row needs 3 columns per query. 6 × 2 queries need 6 rows and 6 columns, 4 × 3 need 4 and 9.

    In an image of 10×20, six kernels of two rows are 2 rows apart: 2 · 5 + 2 = 12 rows, so 2 are padded. Two kernels
    of three columns are 17 columns apart: 17 + 3 = 20 columns.
    """
    grid = OutputGrid.choose(12, (2, 3), (10, 20))
    assert (grid.shape, grid.strides) == ((6, 2), (2, 17))
    assert grid.pads(10, 20) == [0, 0, 2, 0]
    assert grid.pads(5, 10) == [0, 0, 7, 10]
    assert grid.y().tolist() == [
        [[0, 0, 2, 2, 4, 4, 6, 6, 8, 8, 10, 10]],
        [[1, 1, 3, 3, 5, 5, 7, 7, 9, 9, 11, 11]],
    ]
    assert grid.x().tolist() == [[first, first + 17] * 6 for first in (0, 1, 2)]


def test_a_prime_number_of_queries_is_a_single_column():
    """By hand: 7 rows of a 40×30 image; (40 - 1) / 6 is rounded up. The stride along x leads out of the image."""
    grid = OutputGrid.choose(7, (1, 6), (40, 30))
    assert (grid.shape, grid.strides) == ((7, 1), (7, 30))
    assert grid.pads(40, 30) == [0, 0, 7 * 6 + 1 - 40, 0]


def test_a_single_query_in_an_image_smaller_than_the_kernel_is_padded():
    grid = OutputGrid.choose(1, (5, 6), (2, 3))
    assert (grid.shape, grid.strides) == ((1, 1), (2, 6))
    assert grid.pads(2, 3) == [0, 0, 3, 3]


def test_the_output_has_a_pixel_per_query_for_every_width_of_the_kernel():
    """Brute force, by the convolution's formula for the size of its output."""
    images = [(1, 1), (1, 50), (54, 20), (9, 160), (486, 200)]
    for num_queries, points, cameras, largest in product(
        (1, 2, 3, 7, 12, 32, 97, 900), (1, 2, 4, 16), (1, 2, 6), images
    ):
        grid = OutputGrid.choose(num_queries, (points, cameras), largest)
        assert grid.shape[0] * grid.shape[1] == num_queries
        for divisor, kernel in product((1, 2, 8), range(1, cameras + 1)):
            image = tuple(-(-size // divisor) for size in largest)
            *first, bottom, right = grid.pads(*image)
            assert first == [0, 0]
            assert min(bottom, right) >= 0
            rows = (image[0] + bottom - points) // grid.strides[0] + 1
            columns = (image[1] + right - kernel) // grid.strides[1] + 1
            assert (rows, columns) == grid.shape, (num_queries, points, cameras, largest, image, kernel)


def test_the_grid_is_the_position_of_every_point_and_camera_in_the_deformable_convolution():
    grid = OutputGrid.choose(12, (4, 3), (30, 40))
    for query, (row, column) in enumerate(np.ndindex(*grid.shape)):
        for point, camera in np.ndindex(4, 3):
            assert grid.y()[point, 0, query] == point + grid.strides[0] * row
            assert grid.x()[camera, query] == camera + grid.strides[1] * column
