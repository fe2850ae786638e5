"""The ONNX operators that exported graphs may hold.

Everything that this toolkit exports consists of them; `tests/export/test_operators.py` compares the lists with
exported graphs. None of them runs a subgraph, a loop or a random generator, reads a file, or keeps a state.

The operators are the same in all versions of the operator set. If the toolkit exports a further operator, or another
version, add it here.
"""

from ..errors import UsageError

_EXPORTED = """
    Add And Atan BatchNormalization Cast Clip Concat ConstantOfShape Conv CumSum DeformConv Div Exp Expand Gather
    GatherElements Gemm Greater GreaterOrEqual GridSample HardSigmoid Identity IsNaN LayerNormalization Less MatMul
    Max MaxPool Mul NonZero Or Range ReduceMax ReduceMean ReduceSum Relu Reshape Resize Sigmoid Slice Softmax Split
    Squeeze Sub Sum Tile TopK Transpose Unsqueeze Where
"""

# Only quantized graphs hold these. `duospacenet quantize` adds them.
QUANTIZATION_OPERATORS = frozenset({"QuantizeLinear", "DequantizeLinear"})

# The graphs of bundles of schema 1 to 3 hold these as well.
EARLIER_OPERATORS = frozenset({"Reciprocal"})

OPSETS = (19, 20, 21, 22)
# DeformConv exists since 19. Engines that compute GridSample-20 wrongly, or not at all, have GridSample-16.
DEFAULT_OPSET = 19

# By version of ONNX's operator set.
OPERATORS: dict[int, frozenset[str]] = dict.fromkeys(
    OPSETS, frozenset(_EXPORTED.split()) | QUANTIZATION_OPERATORS | EARLIER_OPERATORS
)


def check_opset(opset: int) -> None:
    """Raise UsageError unless this toolkit exports the version `opset` of ONNX's operator set."""
    if opset not in OPSETS:
        raise UsageError(f"--opset: expected {OPSETS[0]} to {OPSETS[-1]}; got {opset!r}.")
