"""Faults of single elements, axes and ranges of a graph's inputs, sampled at random."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from duospacenet.runtime.bundle.manifest import Manifest, TensorSpec, slot_name

from .bench import splice
from .sampled_fault import Random, Sampled, in_graph, inputs_of
from .tensor_edits import DTYPES, read_instead, remap


def input_element(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """An element of a calibration, motion, time or mask is frozen, or read from another place."""
    graph = random.choice(["decoder", "decoder", "decoder", "projector"])
    specs = [spec for spec in inputs_of(manifest, graph) if not spec.name.startswith("slot")]
    if not specs:
        return None
    spec = specs[random.integers(len(specs))]
    places = _legal_places(spec, of_window=graph == "decoder")
    if len(places) < 2:
        return None
    place, other = random.choice(len(places), 2, replace=False)
    index = np.arange(np.prod(spec.shape)).reshape(spec.shape)
    size, words = index.size, _place(spec, places[place])
    effect = random.choice(["frozen", "read from elsewhere", "exchanged"])
    if effect == "frozen":
        value = _frozen_value(spec, places[place], random)
        index[places[place]] = size
        return in_graph(
            f"{graph}.{words} is always {value}", graph, lambda m: remap(m, spec.name, spec.shape, index, value)
        )
    index[places[place]], index[places[other]] = (
        np.ravel_multi_index(places[other], spec.shape),
        np.ravel_multi_index(places[place] if effect == "exchanged" else places[other], spec.shape),
    )
    verb = "exchanged with" if effect == "exchanged" else "read from"
    name = f"{graph}.{words} is {verb} {_place(spec, places[other])}"
    return in_graph(name, graph, lambda m: remap(m, spec.name, spec.shape, index))


def input_axis(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """A whole camera, slot, row or column of an input is exchanged with another, or read from it."""
    graph = random.choice([name for name in manifest.graphs if name != "segmenter"])
    specs = [spec for spec in inputs_of(manifest, graph) if max(spec.shape) > 1 and spec.dtype != "uint8"]
    if graph == "backbone" or not specs:
        return None
    spec = specs[random.integers(len(specs))]
    axes = [
        axis
        for axis, length in enumerate(spec.shape)
        if length > 1 and not (spec.name in ("past_T_now", "time_delta_s", "frame_valid") and axis == 0)
    ]
    if not axes:
        return None
    axis = int(random.choice(axes))
    # The last row of a motion is constant, and so are its exchanges with a row of another motion.
    length = 3 if spec.name == "past_T_now" else spec.shape[axis]
    one, other = random.choice(length, 2, replace=False)
    order = np.arange(spec.shape[axis])
    exchanged = bool(random.integers(2))
    order[one], order[other] = other, (one if exchanged else other)
    index = np.arange(np.prod(spec.shape)).reshape(spec.shape).take(order, axis=axis)
    verb = "exchanged with" if exchanged else "read from"
    name = f"{graph}.{spec.name}: axis {axis}, {one} is {verb} {other}"
    return in_graph(name, graph, lambda m: remap(m, spec.name, spec.shape, index))


def image(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """Cameras, colours, rows or columns of the input images are exchanged, or a row is frozen."""
    (spec,) = inputs_of(manifest, "backbone")
    axis = int(random.integers(4))
    if spec.shape[axis] < 2:
        return None
    one, other = random.choice(spec.shape[axis], 2, replace=False)
    order = np.arange(spec.shape[axis])
    order[[one, other]] = other, one
    index = np.arange(np.prod(spec.shape)).reshape(spec.shape)
    parts = ("cameras", "rows", "columns", "colours")[axis]
    if axis in (1, 2) and random.integers(2):
        np.moveaxis(index, axis, 0)[one] = index.size
        return in_graph(
            f"backbone.images: {parts[:-1]} {one} is black in every camera",
            "backbone",
            lambda m: remap(m, spec.name, spec.shape, index, np.zeros(1, np.uint8)),
        )
    camera = int(random.integers(spec.shape[0])) if axis else None
    if camera is None:
        index = index[order]
    else:
        index[camera] = index[camera].take(order, axis=axis - 1)
    where = "" if camera is None else f" of camera {camera}"
    return in_graph(
        f"backbone.images: {parts} {one} and {other}{where} are exchanged",
        "backbone",
        lambda m: remap(m, spec.name, spec.shape, index),
    )


def cached_value(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """The cached values of a slot are read from another slot, layer or camera, or are zero."""
    name = str(random.choice(manifest.memory))
    size = manifest.window.num_frames
    slot = int(random.integers(size))
    spec = next(spec for spec in inputs_of(manifest, "decoder") if spec.name == slot_name(slot, name))
    index = np.arange(np.prod(spec.shape)).reshape(spec.shape)
    effects = ["slot", "slot", "exchanged slots", "layer", "camera", "camera zero", "channels", "cells"]
    effect = str(random.choice(effects))
    if effect in ("slot", "exchanged slots"):
        if size < 2:
            return None
        other = int(random.choice([number for number in range(size) if number != slot]))
        here, there = slot_name(slot, name), slot_name(other, name)
        names = {here: there} | ({there: here} if effect == "exchanged slots" else {})
        verb = "exchanged with" if effect == "exchanged slots" else "read from"
        return in_graph(f"decoder.{here} is {verb} slot {other}", "decoder", lambda m: read_instead(m, names))
    if effect == "layer":
        others = [s.name for s in inputs_of(manifest, "decoder") if s.shape == spec.shape and s.name != spec.name]
        others = [
            other for other in others if other.startswith(f"slot{slot}.") and other.partition(".")[2] in manifest.memory
        ]
        if not others:
            return None
        other_name = str(random.choice(others))
        return in_graph(
            f"decoder.{spec.name} is read from {other_name}",
            "decoder",
            lambda m: read_instead(m, {spec.name: other_name}),
        )
    axis = {"camera": 0, "camera zero": 0, "channels": 1, "cells": 3}[effect]
    if spec.shape[axis] < 2:
        return None
    one, other = (int(number) for number in random.choice(spec.shape[axis], 2, replace=False))
    if effect == "camera zero":
        index[one] = index.size
        return in_graph(
            f"decoder.{spec.name} is zero for camera {one}",
            "decoder",
            lambda m: remap(m, spec.name, spec.shape, index, np.zeros(1, np.float32)),
        )
    order = np.arange(spec.shape[axis])
    if effect == "cells":
        order = np.roll(order, 1)
    else:
        order[[one, other]] = other, one
    index = index.take(order, axis=axis)
    words = (
        "is shifted by one cell"
        if effect == "cells"
        else f"has {effect.removesuffix('s')}s {one} and {other} exchanged"
    )
    return in_graph(f"decoder.{spec.name} {words}", "decoder", lambda m: remap(m, spec.name, spec.shape, index))


def input_range(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """An input is clipped to a part of its legal range."""
    ranges = [
        ("decoder", "time_delta_s", 0, (0.8, 2.0, 4.0)),
        ("decoder", "past_T_now", None, (5.0, 20.0, 60.0)),
        ("decoder", slot_name(0, manifest.memory[0]), None, (10.0, 30.0)),
        ("backbone", "images", 0, (200, 250)),
        ("lifter", "voxel_locations", 0, (0.4, 0.9)),
    ]
    legal = [each for each in ranges if any(spec.name == each[1] for spec in inputs_of(manifest, each[0]))]
    graph, name, lower, uppers = legal[random.integers(len(legal))]
    spec = next(spec for spec in inputs_of(manifest, graph) if spec.name == name)
    upper = random.choice(uppers)
    limits = [np.array(limit, DTYPES[spec.dtype]) for limit in (-upper if lower is None else lower, upper)]
    words = f"{graph}.{name} is clipped to {limits[0]:g} .. {limits[1]:g}"
    return in_graph(words, graph, lambda m: splice(m, name, "Clip", *limits))


def _legal_places(spec: TensorSpec, of_window: bool) -> list[tuple[int, ...]]:
    """The indices of an input whose values are not constant by contract."""
    constant_slot = of_window and spec.name in ("frame_valid", "time_delta_s", "past_T_now")
    return [
        place
        for place in np.ndindex(*spec.shape)
        if not (constant_slot and place[0] == 0) and not (spec.name == "past_T_now" and place[1] == 3)
    ]


def _place(spec: TensorSpec, place: Sequence[int]) -> str:
    return f"{spec.name}[{', '.join(map(str, place))}]"


def _frozen_value(spec: TensorSpec, place: tuple[int, ...], random: Random) -> NDArray:
    """A plausible constant: what a trace of the first frame of a drive would hold."""
    if spec.dtype == "bool":
        return np.array([random.integers(2)], np.bool_)
    if spec.name == "past_T_now":
        return np.array([place[1] == place[2]], np.float32)
    if spec.name == "time_delta_s":
        return np.array([0.5 * place[0]], np.float32)
    return np.array([random.choice([0.0, 1.0, 100.0])], DTYPES[spec.dtype])
