"""Where a graph file computes something else than eager mode: tensor by tensor, each from eager's own values."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ..parity.comparison import TensorError
from .intermediates import Intermediates
from .pieces import CutGraph, Piece

CHUNK_BYTES = 512 * 2**20  # of tensors that eager mode holds at a time; the graph computes the like of them again


@dataclass(frozen=True)
class Deviation:
    """How far one piece of a graph is from eager mode."""

    piece: Piece
    error: TensorError


def deviations(cut: CutGraph, eager: Intermediates, inputs: Mapping[str, Tensor], frame: int) -> list[Deviation]:
    """Every piece of the file on eager's values of what it reads, in the file's order; `inputs` are the graph's."""
    return [deviation for chunk in _chunks(cut, eager) for deviation in _compare(cut, eager, chunk, inputs, frame)]


def _chunks(cut: CutGraph, eager: Intermediates) -> Iterator[list[Piece]]:
    """Pieces in order, as many at a time as memory is granted."""
    chunk, size = [], 0
    for piece in cut.pieces.values():
        size += sum(map(eager.size_bytes, _tensors_of(piece, eager)))
        chunk.append(piece)
        if size > CHUNK_BYTES:
            yield chunk
            chunk, size = [], 0
    if chunk:
        yield chunk


def _compare(
    cut: CutGraph, eager: Intermediates, chunk: list[Piece], inputs: Mapping[str, Tensor], frame: int
) -> Iterator[Deviation]:
    names = dict.fromkeys(name for piece in chunk for name in _tensors_of(piece, eager))
    expected = eager.values(names, inputs)
    given = {name: value.numpy() for name, value in inputs.items()}
    actual = cut.run([piece.tensor for piece in chunk], expected | given)
    for piece in chunk:
        yield Deviation(piece, error_of(piece.tensor, actual[piece.tensor], expected[piece.tensor], frame))


def _tensors_of(piece: Piece, eager: Intermediates) -> list[str]:
    """What eager mode has to give for a piece: what it reads, the graph's inputs aside, and what it makes."""
    return [name for name in (piece.tensor, *piece.reads) if name in eager.names]


def error_of(name: str, actual: NDArray, expected: NDArray, frame: int) -> TensorError:
    """On the way to a result, a NaN or an infinity may be right: where both sides have the same one."""
    if actual.shape == expected.shape:
        same = ~np.isfinite(expected) & ((actual == expected) | (np.isnan(actual) & np.isnan(expected)))
        actual, expected = np.where(same, 0, actual), np.where(same, 0, expected)
    compare = TensorError.between_boxes if name == "boxes" else TensorError.between
    return compare(actual, expected, frame)
