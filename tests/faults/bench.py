"""A test bench for faults: a copy of a bundle, a model, and patches that are undone at the end."""

import copy
import shutil
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from unittest import mock

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import NodeProto, helper, numpy_helper

from duospacenet.export.parity import reference
from duospacenet.model import DuoSpaceNet
from duospacenet.runtime import Frame, pipeline, preprocessing
from duospacenet.runtime.bundle.bundle_files import check_files
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.errors import ArtifactError
from tests.helpers.bundles import edit_manifest, update_graph_hash

Prepare = Callable[..., preprocessing.NetworkInputs]


class Bench:
    """Holds a copy of `bundle` and a `model`, and changes them or the code for the duration of a `with` block.

    changed_graphs: names of the edited graphs.
    refused_before_rehash: whether the runtime refused the last edited graph by its hash.
    """

    def __init__(self, bundle: Path, model: DuoSpaceNet, folder: Path) -> None:
        self.bundle = Path(shutil.copytree(bundle, folder / "bundle", dirs_exist_ok=True))
        self.model = model
        self.random = np.random.default_rng(0)
        self.changed_graphs: set[str] = set()
        self.refused_before_rehash = False
        self._patches = ExitStack()

    def __enter__(self) -> Self:
        self._patches.callback(torch.set_num_threads, torch.get_num_threads())
        torch.set_num_threads(1)  # on such small tensors, threads take more time than they save
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._patches.close()

    def patch(self, name: str, value: Any, *holders: Any) -> None:
        """Replace the attribute `name` of each of these modules or classes."""
        for holder in holders:
            self._patches.enter_context(mock.patch.object(holder, name, value))

    def edit_graph(self, name: str, change: Callable[[onnx.ModelProto], None]) -> None:
        """Change a graph file and update its hash in the manifest. Otherwise the hash check would refuse the bundle."""
        path = self.bundle / f"{name}.onnx"
        model = onnx.load(path)
        change(model)
        onnx.save(model, path)
        self.changed_graphs.add(name)
        self.refused_before_rehash = _is_refused(self.bundle)
        update_graph_hash(self.bundle, name)

    def edit_manifest(self, change: Callable[[dict[str, Any]], None]) -> None:
        edit_manifest(self.bundle, change)

    def edit_model(self, change: Callable[[DuoSpaceNet], None]) -> None:
        """Replace the model by a changed copy."""
        self.model = copy.deepcopy(self.model)
        change(self.model)

    def change_stream_frames(self, change: Callable[[Frame], Frame]) -> None:
        """Give the stream changed frames. The reference gets the original ones."""
        step = pipeline.Stream.step
        self.patch("step", lambda stream, frame: step(stream, change(frame)), pipeline.Stream)

    def change_stream_preparation(self, broken: Callable[[Prepare], Prepare]) -> None:
        """Change the preprocessing of the stream alone."""
        self.patch("prepare", broken(preprocessing.prepare), pipeline)

    def change_shared_preparation(self, broken: Callable[[Prepare], Prepare]) -> None:
        """Change the preprocessing that the stream and the reference share."""
        self.patch("prepare", broken(preprocessing.prepare), pipeline, reference, preprocessing)


def _is_refused(bundle: Path) -> bool:
    try:
        check_files(bundle, read_manifest(bundle))
    except ArtifactError:
        return True
    return False


# ---------------------------------------------------------------------------------------------------------------------
# Edits of a graph file


def producer_of(model: onnx.ModelProto, output: str) -> NodeProto:
    """The node that computes a tensor."""
    return next(node for node in model.graph.node if output in node.output)


def nodes_of(model: onnx.ModelProto, operator: str) -> list[NodeProto]:
    return [node for node in model.graph.node if node.op_type == operator]


def set_attribute(node: NodeProto, name: str, value: Any) -> None:
    kept = [attribute for attribute in node.attribute if attribute.name != name]
    del node.attribute[:]
    node.attribute.extend([*kept, helper.make_attribute(name, value)])


def constant(model: onnx.ModelProto, value: NDArray, name: str = "fault.constant") -> str:
    """Add an initializer and return its name."""
    model.graph.initializer.append(numpy_helper.from_array(value, name))
    return name


def edit_weight(model: onnx.ModelProto, suffix: str, change: Callable[[NDArray], NDArray]) -> None:
    """Apply `change` to the initializer whose name ends with `suffix`."""
    tensor = next(tensor for tensor in model.graph.initializer if tensor.name.endswith(suffix))
    value = change(numpy_helper.to_array(tensor).copy())
    tensor.CopyFrom(numpy_helper.from_array(value.astype(numpy_helper.to_array(tensor).dtype), tensor.name))


def splice(model: onnx.ModelProto, name: str, operator: str, *constants: NDArray, **attributes: Any) -> None:
    """Insert an operator after the tensor `name`, so that all its readers get the operator's result.

    If `name` is an output of the graph, the result becomes the output.

    constants: further inputs of the operator.
    attributes: its attributes.
    """
    nodes = model.graph.node
    raw = f"fault.{name}.{len(nodes)}"
    extra = [constant(model, value, f"{raw}.{index}") for index, value in enumerate(constants)]
    if any(name in node.output for node in nodes):
        index, source = next(i for i, node in enumerate(nodes) if name in node.output), producer_of(model, name)
        source.output[:] = [raw if output == name else output for output in source.output]
        nodes.insert(index + 1, helper.make_node(operator, [raw, *extra], [name], **attributes))
        return
    for node in nodes:
        node.input[:] = [raw if x == name else x for x in node.input]
    nodes.insert(0, helper.make_node(operator, [name, *extra], [raw], **attributes))
