"""A place to break things: a bundle of its own, a model, and patches that are gone when the bench is cleared."""

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
from duospacenet.runtime.bundle.manifest import check_files, read_manifest
from duospacenet.runtime.errors import ArtifactError
from tests.helpers.bundles import edit_manifest, update_graph_hash

Prepare = Callable[..., preprocessing.NetworkInputs]


class Bench:
    """Holds a copy of `bundle` and a `model`. What is changed through it is changed for the time of the `with`."""

    def __init__(self, bundle: Path, model: DuoSpaceNet, folder: Path) -> None:
        self.bundle = Path(shutil.copytree(bundle, folder / "bundle", dirs_exist_ok=True))
        self.model = model
        self.random = np.random.default_rng(0)
        self.changed_graphs: set[str] = set()
        self.refused_before_rehash = False
        self._patches = ExitStack()

    def __enter__(self) -> Self:
        self._patches.callback(torch.set_num_threads, torch.get_num_threads())
        torch.set_num_threads(1)  # on tensors this small, threads cost more than they bring
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._patches.close()

    def patch(self, name: str, value: Any, *holders: Any) -> None:
        """Replace what is called `name` in each of these modules or classes."""
        for holder in holders:
            self._patches.enter_context(mock.patch.object(holder, name, value))

    def edit_graph(self, name: str, change: Callable[[onnx.ModelProto], None]) -> None:
        """Change a graph file, and its hash with it, so that the check of the files does not stop the others."""
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
        """Change a copy of the model, which stands for it from now on."""
        self.model = copy.deepcopy(self.model)
        change(self.model)

    def change_stream_frames(self, change: Callable[[Frame], Frame]) -> None:
        """Let the stream see other frames than the reference."""
        step = pipeline.Stream.step
        self.patch("step", lambda stream, frame: step(stream, change(frame)), pipeline.Stream)

    def change_stream_preparation(self, broken: Callable[[Prepare], Prepare]) -> None:
        """Break the pre-processing of the stream alone."""
        self.patch("prepare_inputs", broken(preprocessing.prepare_inputs), pipeline)

    def change_shared_preparation(self, broken: Callable[[Prepare], Prepare]) -> None:
        """Break the pre-processing itself, which the reference shares."""
        self.patch("prepare_inputs", broken(preprocessing.prepare_inputs), pipeline, reference, preprocessing)


def _is_refused(bundle: Path) -> bool:
    try:
        check_files(bundle, read_manifest(bundle))
    except ArtifactError:
        return True
    return False


# ---------------------------------------------------------------------------------------------------------------------
# Cuts and stitches in a graph file


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
    """Add a tensor to the file."""
    model.graph.initializer.append(numpy_helper.from_array(value, name))
    return name


def edit_weight(model: onnx.ModelProto, suffix: str, change: Callable[[NDArray], NDArray]) -> None:
    """Replace a tensor in the file by what `change` makes of it."""
    tensor = next(tensor for tensor in model.graph.initializer if tensor.name.endswith(suffix))
    value = change(numpy_helper.to_array(tensor).copy())
    tensor.CopyFrom(numpy_helper.from_array(value.astype(numpy_helper.to_array(tensor).dtype), tensor.name))


def splice(model: onnx.ModelProto, name: str, operator: str, *constants: NDArray, **attributes: Any) -> None:
    """Put an operator between a tensor and all that read it; an output of the graph counts as a reader."""
    nodes = model.graph.node
    raw = f"fault.{name}.{len(nodes)}"
    extra = [constant(model, value, f"{raw}.{index}") for index, value in enumerate(constants)]
    if any(name in node.output for node in nodes):
        index, source = next(i for i, node in enumerate(nodes) if name in node.output), producer_of(model, name)
        source.output[:] = [raw if output == name else output for output in source.output]
        nodes.insert(index + 1, helper.make_node(operator, [raw, *extra], [name], **attributes))
        return
    for node in nodes:
        node.input[:] = [raw if put == name else put for put in node.input]
    nodes.insert(0, helper.make_node(operator, [name, *extra], [raw], **attributes))
