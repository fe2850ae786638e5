"""Both ONNX forms of deformable sampling in onnxruntime, against a loop over the equation."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
import onnx
import pytest
import torch
from torch import Tensor, nn

from duospacenet.export.graphs import Graph
from duospacenet.export.operator_forms import TRANSLATIONS, OperatorForms
from duospacenet.export.sampling_forms import VisibleLists
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
    "four frames": random_inputs([(9, 6), (5, 3)], 4, 3, num_queries=11, num_heads=2, num_points=4, seed=2),
    "lifting": random_inputs(FOUR_LEVELS, 1, 6, num_queries=96, has_offsets=False, has_weights=False, seed=3),
    "one query": random_inputs(FOUR_LEVELS, 1, 6, num_queries=1, num_heads=2, num_points=2, seed=4),
    "no offsets and no weights": random_inputs([(5, 7)], 4, 1, num_queries=2, has_offsets=False, has_weights=False),
    "no offsets": random_inputs([(5, 7), (3, 4)], 1, 6, num_queries=7, has_offsets=False, seed=6),
    "no weights": random_inputs([(5, 7), (3, 4)], 2, 6, num_queries=13, num_points=1, has_weights=False, seed=8),
    "97 queries": random_inputs([(4, 15)], 1, 3, num_queries=97, num_heads=2, seed=7),
    "a single pixel": random_inputs([(1, 1)], 1, 6, num_queries=6, num_points=2, seed=10),
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
    """Traces a case once: in the compact form, and PV attention in the form "grid-sample" too."""

    @functools.cache
    def trace_once(name: str) -> Traced:
        inputs, folder = CASES[name].to(torch.float32), tmp_path_factory.mktemp("graphs")
        forms = FORMS if name == "PV attention" else ("compact",)
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
            assert_close(result, expected, 1e-5)


def visible_in(shape: tuple[int, ...], most: int) -> Tensor:
    """A random mask (T, N, Q) with at most `most` cameras per location, and as many for the first one."""
    num_frames, num_cameras, num_queries = shape
    rng, visible = np.random.default_rng(most), np.zeros(shape, dtype=bool)
    for t, q in np.ndindex(num_frames, num_queries):
        count = most if t == q == 0 else rng.integers(most + 1)
        visible[t, rng.permutation(num_cameras)[:count], q] = True
    return torch.tensor(visible)


def test_the_forms_sample_each_level_of_each_frame_once(traced):
    """Only the compact form has operators with dynamic shapes."""
    for form, file in traced.files.items():
        operators = [node.op_type for node in onnx.load(file).graph.node]
        assert operators.count("GridSample") == len(traced.inputs.values)
        assert ({"NonZero", "TopK", "Range"} & set(operators)) == (
            {"NonZero", "TopK", "Range"} if form == "compact" else set()
        )


@pytest.mark.parametrize("most_visible", [0, 1, 6])
def test_the_compact_form_samples_no_more_locations_per_camera_than_the_longest_list_has(
    pv_attention, tmp_path, most_visible
):
    visible = visible_in(pv_attention.inputs.visible.shape, most_visible)
    model = onnx.load(pv_attention.files["compact"])
    names = [node.output[0] for node in model.graph.node if node.op_type == "GridSample"]
    model.graph.output.extend(onnx.ValueInfoProto(name=name) for name in names)
    onnx.save(model, tmp_path / "samples.onnx")
    arrays = {name: tensor.numpy() for name, tensor in pv_attention.inputs._replace(visible=visible).tensors().items()}
    samples = session_on_pool(tmp_path / "samples.onnx").run(names, arrays)
    longest = max(1, int(visible.sum(dim=2).max()))
    cameras_and_heads, channels, points = 6 * 4, 3, 2
    assert {each.shape for each in samples} == {(cameras_and_heads, channels, longest, points)}


def test_both_forms_compute_the_same(pv_attention):
    one, other = (run(pv_attention.files[form], pv_attention.inputs) for form in FORMS)
    assert_close(one, other, 1e-6)


@pytest.mark.parametrize(
    "offset", [(1e30, 0), (-1e30, 0), (0, 1e30), (0, -1e30), (1e5, 1e5), (7.6, 0), (-7.6, 0), (0, 5.6), (0, -5.6)]
)
def test_samples_outside_a_camera_are_zero(pv_attention, offset):
    """The largest image has 5×7 cells. A sample half a cell outside it is zero."""
    inputs = pv_attention.inputs
    inputs = inputs._replace(
        offsets=torch.tensor(offset, dtype=torch.float32).expand(inputs.offsets.shape).contiguous(),
        visible=torch.ones_like(inputs.visible),
        values=[torch.ones_like(value) for value in inputs.values],
    )
    for form, file in pv_attention.files.items():
        assert run(file, inputs).eq(0).all(), form


@pytest.mark.parametrize("number", [torch.nan, -1e30, 0.5])
def test_the_locations_in_cameras_in_which_they_are_not_visible_have_no_effect(traced, number):
    inputs = traced.inputs
    hidden = inputs._replace(locations=torch.where(inputs.visible[:, :, None], inputs.locations, number))
    for file in traced.files.values():
        assert torch.equal(run(file, hidden), run(file, inputs))


# --- An empty slot ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("empty", [0, 1])
@pytest.mark.parametrize("broken", [("locations",), ("locations", "offsets", "weights")])
def test_a_frame_of_nan_in_which_nothing_is_visible_does_not_change_the_other(pv_attention, empty, broken):
    """An empty slot of the window may hold NaN everywhere."""
    inputs = pv_attention.inputs._replace(visible=pv_attention.inputs.visible.clone())
    inputs.visible[empty] = False
    other = 1 - empty
    expected = sample_by_loop(inputs)[other]
    tensors = {name: tensor.clone() for name, tensor in inputs.tensors().items()}
    for name in broken:
        tensors[name][empty] = torch.nan
    num_levels = len(inputs.values) // 2
    for i in range(empty * num_levels, (empty + 1) * num_levels):
        tensors[f"value_{i}"].fill_(torch.nan)
    for form, file in pv_attention.files.items():
        result = run(file, inputs.with_tensors(tensors))
        assert_close(result[other], expected, 1e-5)
        if form == "compact" or "weights" not in broken:
            assert result[empty].eq(0).all()


# --- The lists of visible locations -------------------------------------------------------------------------------


@torch.library.custom_op("duospacenet_tests::visible_lists", mutates_args=())
def visible_lists(visible: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """An operator that is exported as the fields of `VisibleLists`. It has no other implementation."""
    raise NotImplementedError


@visible_lists.register_fake
def _(visible: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The largest possible shapes."""
    entries = torch.empty(visible.shape, dtype=torch.int64)
    return entries.flatten(0, 1), torch.empty_like(visible).flatten(0, 1), entries.clone()


class _Lists(nn.Module):
    def forward(self, visible: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return visible_lists(visible)


class Lists(NamedTuple):
    locations: np.ndarray
    used: np.ndarray
    entries: np.ndarray

    def by_camera(self) -> list[list[int]]:
        """The used list entries of each camera of each frame."""
        return [row[used].tolist() for row, used in zip(self.locations, self.used, strict=True)]

    def by_location(self, none: int) -> list[list[list[int]]]:
        """For each frame and location the list entries that hold it. `none` stands for no entry."""
        return [[sorted(set(column) - {none}) for column in frame.T.tolist()] for frame in self.entries]


@pytest.fixture
def find_lists(tmp_path, monkeypatch) -> Callable[[list], Lists]:
    """Runs `VisibleLists` as a graph of its own."""

    def find(visible: list) -> Lists:
        mask = torch.tensor(visible, dtype=torch.bool)
        names = ("locations", "used", "entries")
        graph = Graph("decoder", _Lists(), {"visible": mask}, dict.fromkeys(names, mask))
        trace(graph, tmp_path / "lists.onnx")
        return Lists(*session_on_pool(tmp_path / "lists.onnx").run(list(names), {"visible": mask.numpy()}))

    def translate(visible):
        lists = VisibleLists.find(visible)
        return lists.locations, lists.used, lists.entries

    monkeypatch.setitem(TRANSLATIONS, torch.ops.duospacenet_tests.visible_lists.default, translate)
    return find


def test_the_lists_of_two_frames_of_three_cameras(find_lists):
    """By hand. In the first frame, the second camera sees nothing. The longest list has 3 entries, so camera n of a
    frame has the entries 3n, 3n + 1 and 3n + 2, and 9 stands for no entry. Location 3 is visible in two cameras.
    """
    lists = find_lists(
        [
            [[0, 1, 0, 1, 1], [0, 0, 0, 0, 0], [0, 0, 0, 1, 0]],
            [[1, 0, 0, 0, 0], [0, 0, 1, 0, 1], [0, 0, 0, 0, 0]],
        ]
    )
    assert lists.used.tolist() == [
        [True, True, True],
        [False, False, False],
        [True, False, False],
        [True, False, False],
        [True, True, False],
        [False, False, False],
    ]
    assert lists.by_camera() == [[1, 3, 4], [], [3], [0], [2, 4], []]
    assert lists.entries.shape == (2, 2, 5)
    assert lists.by_location(none=9) == [[[], [0], [], [1, 6], [2]], [[0], [], [3], [], [4]]]
    # Unused entries are numbers of locations too.
    assert lists.locations.min() >= 0
    assert lists.locations.max() < 5


def test_if_nobody_sees_anything_the_lists_have_one_unused_entry(find_lists):
    lists = find_lists([[[0] * 7] * 3] * 2)
    assert (lists.locations.shape, lists.used.any(), lists.entries.shape) == ((6, 1), False, (2, 1, 7))
    assert set(lists.locations.flatten()) <= set(range(7))
    assert (lists.entries == 3).all()


def test_if_everybody_sees_everything_the_lists_hold_all_locations(find_lists):
    """Camera n of a frame has the entries 7n to 7n + 6."""
    lists = find_lists([[[1] * 7] * 3] * 4)
    assert lists.used.all()
    assert lists.by_camera() == [list(range(7))] * 12
    assert lists.entries.shape == (4, 3, 7)
    assert lists.by_location(none=21) == [[[q, q + 7, q + 14] for q in range(7)]] * 4


def test_a_single_camera_that_sees_a_single_location(find_lists):
    lists = find_lists([[[1]]])
    assert (lists.locations.tolist(), lists.used.tolist(), lists.entries.tolist()) == ([[0]], [[True]], [[[0]]])


@pytest.mark.parametrize(("frames", "cameras", "locations"), [(1, 1, 97), (1, 6, 13), (4, 6, 31), (4, 1, 2)])
def test_random_lists_equal_a_loop(find_lists, frames, cameras, locations):
    visible = np.random.default_rng(locations).uniform(size=(frames, cameras, locations)) < 0.3
    lists = find_lists(visible.tolist())
    expected = [[q for q in range(locations) if row[q]] for row in visible.reshape(-1, locations)]
    longest = max(map(len, expected))
    assert lists.by_camera() == expected
    assert lists.locations.shape == (frames * cameras, longest)
    assert lists.by_location(none=cameras * longest) == [
        [
            [n * longest + expected[t * cameras + n].index(q) for n in range(cameras) if visible[t, n, q]]
            for q in range(locations)
        ]
        for t in range(frames)
    ]
