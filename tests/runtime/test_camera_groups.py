"""A backbone for a few cameras runs group by group, and its outputs are those of a single run."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from duospacenet.runtime.bundle.manifest import GraphSpec, TensorSpec
from duospacenet.runtime.camera_groups import CameraGroups
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.onnxruntime_session import OnnxruntimeSession, set_thread_pool_size
from duospacenet.runtime.session import to_tensors

NUM_CAMERAS, HEIGHT, WIDTH = 6, 4, 5
SIZES = [1, 2, 3]


def colour_session(size: int) -> tuple[OnnxruntimeSession, GraphSpec]:
    """A session that returns the colours of `size` cameras, at full and at half size."""
    nodes = [
        helper.make_node("Cast", ["images"], ["float"], to=TensorProto.FLOAT),
        helper.make_node("Transpose", ["float"], ["pv_full"], perm=[0, 3, 1, 2]),
        helper.make_node("MaxPool", ["pv_full"], ["pv_half"], kernel_shape=[2, 2], strides=[2, 2]),
    ]
    images = TensorSpec(name="images", shape=(size, HEIGHT, WIDTH, 3), dtype="uint8")
    outputs = [
        TensorSpec(name="pv_full", shape=(size, 3, HEIGHT, WIDTH), dtype="float32"),
        TensorSpec(name="pv_half", shape=(size, 3, HEIGHT // 2, WIDTH // 2), dtype="float32"),
    ]
    graph = helper.make_graph(
        nodes,
        "backbone",
        [helper.make_tensor_value_info("images", TensorProto.UINT8, images.shape)],
        [helper.make_tensor_value_info(each.name, TensorProto.FLOAT, each.shape) for each in outputs],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    onnx.checker.check_model(model, full_check=True)
    set_thread_pool_size(available_cores())
    spec = GraphSpec(file="backbone.onnx", sha256="", inputs=(images,), outputs=tuple(outputs))
    return OnnxruntimeSession(model.SerializeToString(), spec, Path("backbone.onnx")), spec


class CountedRuns:
    """A session that keeps the images of each run."""

    precision = "float32"

    def __init__(self, session):
        self._session, self.images = session, []

    def run(self, tensors):
        self.images.append(tensors["images"].numpy().copy())
        return self._session.run(tensors)


@pytest.fixture(scope="module")
def images():
    return np.random.default_rng(0).integers(1, 256, (NUM_CAMERAS, HEIGHT, WIDTH, 3), dtype=np.uint8)


def run_groups(size, images, camera_valid=None):
    """The outputs of the groups as arrays, and the images of each run."""
    session, spec = colour_session(size)
    counted = CountedRuns(session)
    flags = {} if camera_valid is None else {"camera_valid": np.array(camera_valid)}
    outputs = CameraGroups(counted, spec, NUM_CAMERAS).run(to_tensors(images=images, **flags))
    return {name: value.numpy() for name, value in outputs.items()}, counted.images


@pytest.mark.parametrize("size", SIZES)
def test_the_outputs_equal_those_of_all_cameras_at_once_bit_for_bit(size, images):
    outputs, runs = run_groups(size, images)
    together = colour_session(NUM_CAMERAS)[0].run(to_tensors(images=images))
    assert list(outputs) == list(together) == ["pv_full", "pv_half"]
    for name, value in together.items():
        assert outputs[name].dtype == np.float32
        assert outputs[name].tobytes() == value.numpy().tobytes()
        assert outputs[name].shape == tuple(value.shape())
    assert [len(run) for run in runs] == [size] * (NUM_CAMERAS // size)


@pytest.mark.parametrize("size", SIZES)
def test_the_features_of_camera_n_are_at_index_n(size, images):
    outputs, _ = run_groups(size, images)
    np.testing.assert_array_equal(outputs["pv_full"], images.transpose(0, 3, 1, 2))


@pytest.mark.parametrize("size", SIZES)
def test_a_group_of_lost_cameras_is_not_run_and_its_features_are_zeros(size, images):
    """Cameras 0, 1, 2 and 5 are lost. With two at a time that is group 0 whole, and a half of groups 1 and 2."""
    outputs, runs = run_groups(size, images, [False, False, False, True, True, False])
    run_cameras = {1: [3, 4], 2: [2, 3, 4, 5], 3: [3, 4, 5]}[size]
    np.testing.assert_array_equal(np.concatenate(runs), images[run_cameras])
    expected = np.zeros((NUM_CAMERAS, 3, HEIGHT, WIDTH))
    expected[run_cameras] = images[run_cameras].transpose(0, 3, 1, 2)
    np.testing.assert_array_equal(outputs["pv_full"], expected)


def test_without_any_camera_nothing_is_run(images):
    outputs, runs = run_groups(2, images, [False] * NUM_CAMERAS)
    assert runs == []
    assert all(not value.any() and np.isfinite(value).all() for value in outputs.values())


def test_the_outputs_of_two_runs_do_not_share_memory(images):
    session, spec = colour_session(2)
    groups = CameraGroups(session, spec, NUM_CAMERAS)
    first = groups.run(to_tensors(images=images))
    kept = {name: value.numpy().copy() for name, value in first.items()}
    groups.run(to_tensors(images=255 - images))
    assert all(np.array_equal(value.numpy(), kept[name]) for name, value in first.items())
