"""The result of a bisection: the first place where a bundle differs from its model."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

from ...runtime.parity.tensor_error import TensorError
from ...runtime.parity.tolerances import replace_nonfinite

Kind = Literal[
    "none",
    "tensor",
    "trace",
    "optimiser",
    "rounding",
    "input",
    "stream input",
    "stream output",
    "constant",
    "operator",
    "manifest",
]


@dataclass(frozen=True)
class Bisection:
    """The first place where a bundle differs from its model.

    kind: the kind of difference.
        "none": no output differs. The parity check passes, or its frames do not cover enough.
        "tensor": a tensor in a graph file has a wrong value, or is computed differently than in a fresh export.
        "trace": the traced program already differs from the model.
        "optimiser": the graph file is right, but a session with onnxruntime's optimisations is wrong.
        "rounding": every tensor alone is right and as in a fresh export, but small errors add up.
        "input": all outputs agree, but an element of an input changes them differently.
        "stream input": the graphs are right, but the pipeline gave a graph a wrong input.
        "stream output": graphs and inputs are right, but the pipeline's result is wrong.
        "constant": all outputs agree within the tolerance, but constants of the graphs are not the model's weights.
        "operator": all outputs agree within the tolerance, but a new export of the model has other operators.
        "manifest": the graphs are right, but the manifest is not.
    graph: name of the graph.
    tensor: name of the graph's tensor or input.
    frame: index of the frame; None on random inputs.
    seed: of the random inputs; None on a frame.
    operators: the ONNX operators that compute the tensor.
    module: path of the module in the model that computes the tensor.
    source: source line that computes the tensor.
    error: error of the tensor.
    reads: names of the tensors from which it is computed.
    remarks: known causes, one sentence each.
    num_off: number of wrong tensors in the graph.
    num_compared: number of compared tensors in the graph.
    others: further failing outputs and inputs, of which the causes were not searched.
    """

    kind: Kind
    graph: str = ""
    frame: int | None = 0
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
    seed: int | None = None

    @property
    def case(self) -> str:
        """The inputs on which it differs, in words."""
        return f"frame {self.frame}" if self.seed is None else f"random input {self.seed}"

    @property
    def place(self) -> str:
        """The graph and the tensor, as `graph.tensor`. Empty if the difference is not in a graph."""
        return f"{self.graph}.{self.tensor}" if self.graph else ""

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values. Numbers that are not finite become None."""
        return replace_nonfinite(asdict(self))
