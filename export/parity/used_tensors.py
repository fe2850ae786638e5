"""The tensors of the model that the outputs of a graph depend on."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.func import functional_call
from torch.nn.functional import grid_sample
from torch.overrides import TorchFunctionMode

from ...model import DuoSpaceNet
from ...model.backbones.deformable_convolution import DeformableConvolution
from ..graphs import Graph

CONVOLUTIONS = (nn.Conv2d, nn.Conv3d, DeformableConvolution)
BATCH_NORMS = (nn.BatchNorm2d, nn.BatchNorm3d)
_PREFIX = "model."  # a graph's module is a wrapper that holds the model as its attribute `model`


class Fold(NamedTuple):
    """A convolution and the BatchNorm of its result, by their names in the model. The exporter may fold the two."""

    convolution: str
    batch_norm: str
    eps: float


@dataclass(frozen=True)
class UsedTensors:
    """The tensors of the model that the outputs of one graph depend on.

    tensors: parameters and floating-point buffers, by their names in the model.
    folds: the convolutions with a BatchNorm.
    """

    tensors: dict[str, Tensor]
    folds: tuple[Fold, ...]


def used_tensors(graph: Graph) -> UsedTensors:
    """Find the tensors of its model that the outputs of `graph` depend on.

    The graph's module runs on the meta device, which computes only shapes, and autograd records what each output
    depends on. So the result comes from the model alone, not from its file. An example: the class logits of the first
    decoder layers are not an output, so no graph needs the weights of these heads.
    """
    model = graph.model
    tensors = _floating_point_tensors(model)
    # PyTorch has no gradient for running statistics. They are used if the weight of their BatchNorm is.
    leaves = {name: tensor.detach().to("meta") for name, tensor in tensors.items()}
    for name, leaf in leaves.items():
        leaf.requires_grad_(not _is_statistic(name))
    with torch.enable_grad(), _SamplingOfShapes(), _recorded_folds(model) as folds:
        named = {_PREFIX + name: leaf for name, leaf in leaves.items()}
        outputs = functional_call(graph.module, named, tuple(graph.inputs.values()))
    names = {id(leaf): name for name, leaf in leaves.items()}
    used = {names[id(leaf)] for leaf in _leaves_of(outputs)}
    used |= {name for name in leaves if _is_statistic(name) and f"{name.rpartition('.')[0]}.weight" in used}
    return UsedTensors(
        {name: tensor for name, tensor in tensors.items() if name in used},
        tuple(fold for fold in folds if f"{fold.convolution}.weight" in used),
    )


class _SamplingOfShapes(TorchFunctionMode):
    """Replaces grid_sample by a sum with the same shape and the same dependencies.

    On the meta device PyTorch decomposes grid_sample into hundreds of operators, which takes seconds.
    """

    def __torch_function__(
        self, function: Callable[..., Any], types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        if function is not grid_sample:
            return function(*args, **(kwargs or {}))
        features, grid = args[:2]
        return (features.sum() + grid.sum()).expand(*features.shape[:2], *grid.shape[1:-1])


def _floating_point_tensors(model: DuoSpaceNet) -> dict[str, Tensor]:
    """All parameters, and the buffers that hold floating-point numbers, by name."""
    tensors = {**dict(model.named_parameters()), **dict(model.named_buffers())}
    return {name: tensor for name, tensor in tensors.items() if tensor.is_floating_point()}


def _is_statistic(name: str) -> bool:
    return name.endswith((".running_mean", ".running_var"))


def _leaves_of(outputs: Iterable[Tensor]) -> Iterator[Tensor]:
    """The tensors at the ends of the autograd graph of `outputs`."""
    pending, seen = [output.grad_fn for output in outputs], set()
    while pending:
        node = pending.pop()
        if node is None or node in seen:
            continue
        seen.add(node)
        if isinstance(leaf := getattr(node, "variable", None), Tensor):
            yield leaf
        pending += [function for function, _ in node.next_functions]


@contextmanager
def _recorded_folds(model: nn.Module) -> Iterator[list[Fold]]:
    """Record which BatchNorm is applied to the result of which convolution while the model runs."""
    results: list[tuple[str, Tensor]] = []
    folds: list[Fold] = []

    def keep_result(name: str) -> Callable[..., None]:
        return lambda convolution, inputs, output: results.append((name, output))

    def record_fold(name: str) -> Callable[..., None]:
        def hook(batch_norm: nn.BatchNorm2d | nn.BatchNorm3d, inputs: tuple[Tensor, ...]) -> None:
            folds.extend(Fold(conv, name, batch_norm.eps) for conv, output in results if output is inputs[0])

        return hook

    handles = []
    for name, module in model.named_modules():
        if isinstance(module, CONVOLUTIONS):
            handles.append(module.register_forward_hook(keep_result(name)))
        elif isinstance(module, BATCH_NORMS):
            handles.append(module.register_forward_pre_hook(record_fold(name)))
    try:
        yield folds
    finally:
        for handle in handles:
            handle.remove()
