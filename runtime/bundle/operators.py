"""The ONNX operators that exported graphs may hold.

Everything that this toolkit exports consists of them; `tests/export/test_operators.py` compares the lists with
exported graphs. None of them runs a subgraph, a loop or a random generator, reads a file, or keeps a state.

If the toolkit exports a further operator, or another version of ONNX's operator set, add it here.
"""

_OPERATORS_20 = """
    Add And Atan BatchNormalization Cast Clip Concat ConstantOfShape Conv CumSum DeformConv Div Exp Expand Gather
    GatherElements Gemm Greater GreaterOrEqual GridSample HardSigmoid Identity IsNaN LayerNormalization Less MatMul
    Max MaxPool Mul NonZero Or Range ReduceMax ReduceMean ReduceSum Relu Reshape Resize Sigmoid Slice Softmax Split
    Squeeze Sub Sum Tile TopK Transpose Unsqueeze Where
"""

# Only quantized graphs hold these. `duospacenet quantize` adds them.
QUANTIZATION_OPERATORS = frozenset({"QuantizeLinear", "DequantizeLinear"})

# The graphs of bundles of schema 1 to 3 hold these as well.
EARLIER_OPERATORS = frozenset({"Reciprocal"})

# By version of ONNX's operator set.
OPERATORS: dict[int, frozenset[str]] = {
    20: frozenset(_OPERATORS_20.split()) | QUANTIZATION_OPERATORS | EARLIER_OPERATORS
}
