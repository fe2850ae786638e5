"""Responses to a disturbance: rounded weights pass, an ignored or exchanged input does not."""

import numpy as np
import torch

from duospacenet.export.parity.quantized_liveness import Responses

INPUTS = {"a": torch.arange(1.0, 7.0), "b": torch.arange(7.0, 1.0, -1.0)}
DISTURBED = {**INPUTS, "a": INPUTS["a"] * 1.07}


def model(tensors):
    return {"sum": (3 * tensors["a"] + 2 * tensors["b"]).numpy(), "b alone": tensors["b"].numpy()}


def rounded(tensors):
    return {"sum": (3.1 * tensors["a"] + 1.9 * tensors["b"]).numpy() + 5, "b alone": 0.9 * tensors["b"].numpy()}


def are_equal(dequantized, disturbed=DISTURBED) -> bool:
    return Responses(INPUTS, model, dequantized).are_equal(disturbed)


def test_rounded_weights_respond_alike():
    assert are_equal(rounded)


def test_an_ignored_input_has_no_response():
    assert not are_equal(lambda tensors: rounded({**tensors, "a": INPUTS["a"]}))


def test_exchanged_inputs_respond_differently():
    assert not are_equal(lambda tensors: rounded({"a": tensors["b"], "b": tensors["a"]}))


def test_an_output_that_must_not_respond_is_compared_too():
    def leaking(tensors):
        return {**rounded(tensors), "b alone": (tensors["b"] + 0.1 * tensors["a"]).numpy()}

    assert not are_equal(leaking)


def test_nan_is_not_equal():
    def broken(tensors):
        return {name: np.where(tensors["a"].numpy() > 6.1, np.nan, value) for name, value in rounded(tensors).items()}

    assert not are_equal(broken)
