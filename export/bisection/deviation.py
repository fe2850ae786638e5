"""Errors of the intermediate tensors of a graph file, each computed from eager mode's values."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ...runtime.parity.tensor_error import TensorError
from .intermediates import Intermediates
from .pieces import CutGraph, Piece

CHUNK_BYTES = 512 * 2**20  # size of eager mode's tensors in memory at a time; the file's results need the same again


@dataclass(frozen=True)
class Deviation:
    """The error of the tensor that a piece of a graph file computes, against eager mode."""

    piece: Piece
    error: TensorError


def deviations(cut: CutGraph, eager: Intermediates, inputs: Mapping[str, Tensor], frame: int | None) -> list[Deviation]:
    """The deviation of every piece, in the file's order. Each piece runs on eager mode's values.

    cut: the graph file.
    eager: the same graph in eager mode.
    inputs: the graph's inputs, by name.
    frame: index of the frame, for the errors; None on random inputs.
    """
    return [deviation for chunk in _chunks(cut, eager) for deviation in _compare(cut, eager, chunk, inputs, frame)]


def _chunks(cut: CutGraph, eager: Intermediates) -> Iterator[list[Piece]]:
    """All pieces in order, in groups of about `CHUNK_BYTES`."""
    chunk, size = [], 0
    for piece in cut.pieces.values():
        size += sum(map(eager.size_bytes, _eager_tensors(piece, eager)))
        chunk.append(piece)
        if size > CHUNK_BYTES:
            yield chunk
            chunk, size = [], 0
    if chunk:
        yield chunk


def _compare(
    cut: CutGraph, eager: Intermediates, chunk: list[Piece], inputs: Mapping[str, Tensor], frame: int | None
) -> Iterator[Deviation]:
    # One run of eager mode and one session per chunk. A session per piece would be slow, and a session for all pieces
    # would need all intermediate tensors at once.
    names = dict.fromkeys(name for piece in chunk for name in _eager_tensors(piece, eager))
    expected = eager.values(names, inputs)
    graph_inputs = {name: value.numpy() for name, value in inputs.items()}
    actual = cut.run([piece.tensor for piece in chunk], expected | graph_inputs)
    for piece in chunk:
        error = intermediate_error(piece.tensor, actual[piece.tensor], expected[piece.tensor], frame)
        yield Deviation(piece, error)


def _eager_tensors(piece: Piece, eager: Intermediates) -> list[str]:
    """The tensors that eager mode must compute for a piece: its result, and the tensors that it reads.

    The graph's own inputs are not among them.
    """
    return [name for name in (piece.tensor, *piece.reads) if name in eager.names]


def intermediate_error(name: str, actual: NDArray, expected: NDArray, frame: int | None) -> TensorError:
    """The error of a tensor of a graph. Elements that are NaN in eager mode, or the same infinity, have no error.

    Such values are correct inside a graph, because later operators mask them: eager mode's outputs are finite. Another
    form of an operator may leave out what is masked. For example, an empty slot holds NaN and no camera sees into it.
    """
    if actual.shape == expected.shape:
        same = np.isnan(expected) | (np.isinf(expected) & (actual == expected))
        actual, expected = np.where(same, 0, actual), np.where(same, 0, expected)
    return TensorError.between_outputs(name, actual, expected, frame)
