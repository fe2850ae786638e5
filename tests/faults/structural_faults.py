"""Structural faults of a bundle, sampled at random: an element of an input or output, a weight, an operator, a field.

A fault changes a copy of an exported bundle. Its hashes and its seal are made right again, and its parity report still
says that it passed. Excluded are faults that cannot change any result on legal inputs:

- Values that the contract keeps constant: slot 0 of `frame_valid`, `time_delta_s` and `past_T_now`, and the last row of
  `past_T_now`.
- The limits of a Clip, which only keep huge coordinates out of GridSample, and the location of an invisible point,
  which is replaced once more before it is used.
- An exchange of two tensors that hold the same values, such as the operands of a product.
- Another order of parts that are only summed, such as the levels of an attention.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from duospacenet.runtime.bundle.manifest import Manifest, read_manifest

from . import input_faults, manifest_faults, operator_faults, value_faults
from .sampled_fault import Random, Sampled


@dataclass(frozen=True)
class StructuralFault:
    """A fault of a bundle. kind: what it changes. inject: puts it into a bundle folder."""

    name: str
    kind: str
    inject: Callable[[Path], Any]


def structural_fault(seed: int, bundle: Path) -> StructuralFault:
    """The fault with the number `seed`, for a bundle of any configuration. It is not yet in the bundle."""
    random, manifest = np.random.default_rng(seed), read_manifest(bundle)
    shares = np.array([share for _, share in KINDS.values()])
    # A fault that the bundle cannot have, such as an exchange of its only map class, is sampled again.
    while True:
        kind = str(random.choice(list(KINDS), p=shares / shares.sum()))
        if fault := KINDS[kind][0](random, manifest, bundle):
            name, inject = fault
            return StructuralFault(name, kind, inject)


# By kind, the function that samples a fault, and the share of this kind.
KINDS: dict[str, tuple[Callable[[Random, Manifest, Path], Sampled], int]] = {
    "input element": (input_faults.input_element, 6),
    "input axis": (input_faults.input_axis, 3),
    "image": (input_faults.image, 1),
    "cached value": (input_faults.cached_value, 4),
    "input range": (input_faults.input_range, 2),
    "output": (value_faults.output, 3),
    "weight": (value_faults.weight, 2),
    "small constant": (value_faults.small_constant, 2),
    "index": (operator_faults.index_of_gather, 3),
    "slice": (operator_faults.slice_of_another_place, 2),
    "split": (operator_faults.split_in_another_order, 1),
    "operands": (operator_faults.operands, 2),
    "operator": (operator_faults.skipped_operator, 2),
    "attribute": (operator_faults.attribute, 2),
    "manifest": (manifest_faults.manifest_fault, 5),
}
