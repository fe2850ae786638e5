"""The result of a bisection: the first place where a bundle differs from its model."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

from ..parity.comparison import TensorError
from ..parity.parity_result import replace_nonfinite

Kind = Literal["none", "tensor", "trace", "optimiser", "rounding", "dead input", "stream input", "stream output"]


@dataclass(frozen=True)
class Bisection:
    """The first place where a bundle differs from its model.

    kind: the kind of difference.
        "none": the parity check passes.
        "tensor": a tensor in a graph file is computed wrongly, or otherwise than in a fresh export.
        "trace": the traced program already differs from the model.
        "optimiser": the graph file is right, but onnxruntime's optimised session is wrong.
        "rounding": every tensor is right by itself and as in a fresh export, but small errors add up.
        "dead input": no output of a graph depends on one of its inputs.
        "stream input": the graphs are right, but the pipeline gave a graph a wrong input.
        "stream output": graphs and inputs are right, but the pipeline's result is wrong.
    graph, tensor: names of the graph and of its tensor or input.
    frame: index of the frame.
    operators: operators of the file that compute the tensor.
    module, source: path of the module in the model, and source line, that compute the tensor.
    error: error of the tensor.
    reads: tensors from which it is computed.
    remarks: causes, one sentence each, if any are known.
    num_off, num_compared: number of wrong tensors and of all compared tensors in the graph.
    others: further failing outputs and inputs, which were not searched.
    """

    kind: Kind
    graph: str = ""
    frame: int = 0
    tensor: str = ""
    operators: tuple[str, ...] = ()
    module: str = ""
    source: str = ""
    error: TensorError | None = None
    reads: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    num_off: int = 0
    num_compared: int = 0
    others: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """Graph and tensor, as `graph.tensor`. Empty if no graph is to blame."""
        return f"{self.graph}.{self.tensor}" if self.graph else ""

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values. Numbers that are not finite become None."""
        return replace_nonfinite(asdict(self))
