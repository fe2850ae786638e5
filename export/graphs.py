"""The five graphs of a bundle: a thin wrapper each around an untouched model, and what goes in and out by name."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNet, DuoSpaceNetConfig
from ..model.decoder import FrameValues, LayerValues, Window
from ..model.geometry import decode_boxes
from ..model.image_encoder import NUM_LEVELS
from ..model.lifter import LiftingTables
from ..runtime.manifest import GraphName, slot_name

PV_NAMES = [f"pv_{level}" for level in range(NUM_LEVELS)]
TABLE_NAMES = list(LiftingTables._fields)
WINDOW_NAMES = list(Window._fields)


def pv_value_names(config: DuoSpaceNetConfig) -> list[str]:
    """What the backbone graph leaves in memory, by decoder layer and level."""
    return [f"pv_value_{layer}_{level}" for layer in range(config.num_layers) for level in range(NUM_LEVELS)]


def bev_value_names(config: DuoSpaceNetConfig) -> list[str]:
    """What the lifter graph leaves in memory, by decoder layer."""
    return [f"bev_value_{layer}" for layer in range(config.num_layers)]


def memory_names(config: DuoSpaceNetConfig) -> list[str]:
    """All that a frame leaves in memory, in the order in which the decoder takes it."""
    return pv_value_names(config) + bev_value_names(config)


def slot_names(config: DuoSpaceNetConfig) -> list[str]:
    """The decoder's inputs for a whole window, slot by slot."""
    return [slot_name(slot, name) for slot in range(config.num_frames) for name in memory_names(config)]


@dataclass(frozen=True)
class Graph:
    """One graph: a module from tensors to tensors, example inputs by name, and the outputs by name, without data."""

    name: GraphName
    module: nn.Module
    inputs: dict[str, Tensor]
    outputs: dict[str, Tensor]

    @torch.no_grad()
    def __call__(self, inputs: dict[str, Tensor]) -> dict[str, Tensor]:
        """Run the module eagerly, by name."""
        outputs = self.module(*(inputs[name] for name in self.inputs))
        return dict(zip(self.outputs, outputs, strict=True))


def build_graphs(model: DuoSpaceNet) -> list[Graph]:
    """The graphs of `model` in the order in which a frame passes them, with the example inputs of a trace.

    The example is a made-up rig and noise: nothing of it may survive in a graph.
    """
    config = model.config
    wrappers: list[tuple[GraphName, nn.Module, list[str], list[str]]] = [
        ("projector", ProjectorGraph(model), ["image_T_ego", "camera_valid"], TABLE_NAMES),
        ("backbone", BackboneGraph(model), ["images"], PV_NAMES + pv_value_names(config)),
        ("lifter", LifterGraph(model), PV_NAMES + TABLE_NAMES, ["bev", *bev_value_names(config)]),
        ("decoder", DecoderGraph(model), WINDOW_NAMES + slot_names(config), ["class_logits", "boxes"]),
        ("segmenter", SegmenterGraph(model), ["bev"], list(config.map_classes)),
    ]
    example, graphs = _example_inputs(config), []
    for name, module, inputs, outputs in wrappers:
        if name == "decoder":
            example = _fill_window(example, config)
        taken = {key: example[key] for key in inputs}
        with torch.no_grad():
            given = dict(zip(outputs, module(*taken.values()), strict=True))
        graphs.append(Graph(name, module, taken, {key: tensor.to("meta") for key, tensor in given.items()}))
        example |= given
    return graphs


class ProjectorGraph(nn.Module):
    """Calibration to lifting tables; runs when the calibration changes."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, image_T_ego: Tensor, camera_valid: Tensor) -> Sequence[Tensor]:
        return tuple(self.model.projector(image_T_ego, camera_valid))


class BackboneGraph(nn.Module):
    """Images to PV features, and to what they leave in memory."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, images: Tensor) -> Sequence[Tensor]:
        pv = self.model.image_encoder(images)
        values = self.model.decoder.pv_values(pv)
        return (*pv, *(level for layer in values for level in layer))


class LifterGraph(nn.Module):
    """PV features to BEV features, and to what they leave in memory."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Sequence[Tensor]:
        pv, tables = list(inputs[:NUM_LEVELS]), LiftingTables(*inputs[NUM_LEVELS:])
        bev = self.model.divergence_enhancement(self.model.lifter(pv, tables))
        return (bev, *self.model.decoder.bev_values(bev))


class DecoderGraph(nn.Module):
    """The temporal window to class logits (Q, classes) and boxes (Q, 9) in the ego frame."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Sequence[Tensor]:
        config = self.model.config
        window, values = Window(*inputs[: len(WINDOW_NAMES)]), inputs[len(WINDOW_NAMES) :]
        size = len(values) // config.num_frames
        memory = [_frame_values(values[i : i + size], config) for i in range(0, len(values), size)]
        prediction = self.model.detect(memory, window)[-1]
        return prediction.class_logits, decode_boxes(prediction.pose)


class SegmenterGraph(nn.Module):
    """BEV features to one mask of logits (1, 1, X, Y) a map class; runs when asked."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, bev: Tensor) -> Sequence[Tensor]:
        return tuple(self.model.segmentation(bev).values())


def _fill_window(example: dict[str, Tensor], config: DuoSpaceNetConfig) -> dict[str, Tensor]:
    """An example frame as every frame of a window; copies, so that no two inputs are one tensor to the tracer."""
    slots = range(config.num_frames)
    values = {slot_name(slot, name): example[name].clone() for slot in slots for name in memory_names(config)}
    per_frame = {name: torch.stack([example[name]] * len(slots)) for name in ("image_T_ego", "camera_valid")}
    return example | values | per_frame


def _frame_values(values: Sequence[Tensor], config: DuoSpaceNetConfig) -> FrameValues:
    pv, bev = values[: -config.num_layers], values[-config.num_layers :]
    return [
        LayerValues(list(pv[layer * NUM_LEVELS : (layer + 1) * NUM_LEVELS]), bev[layer])
        for layer in range(config.num_layers)
    ]


def _example_inputs(config: DuoSpaceNetConfig) -> dict[str, Tensor]:
    num_cameras, num_frames, image = config.num_cameras, config.num_frames, config.image
    generator = torch.Generator().manual_seed(0)
    return {
        "images": torch.randint(
            0, 256, (num_cameras, image.height_px, image.width_px, 3), dtype=torch.uint8, generator=generator
        ),
        "image_T_ego": torch.randn(num_cameras, 3, 4, generator=generator),
        "camera_valid": torch.ones(num_cameras, dtype=torch.bool),
        "past_T_now": torch.eye(4).expand(num_frames, -1, -1).clone(),
        "time_delta_s": 0.5 * torch.arange(num_frames, dtype=torch.float32),
        "frame_valid": torch.ones(num_frames, dtype=torch.bool),
    }
