"""The graphs of a bundle: a thin wrapper each around an untouched model, and what goes in and out by name."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNet, DuoSpaceNetConfig
from ..model.decoder import FrameMemory
from ..model.geometry import decode_boxes
from ..model.image_encoder import NUM_LEVELS
from ..model.lifter import LiftingTables
from ..model.window import Window
from ..runtime.manifest import GraphName, slot_name

PV_NAMES = [f"pv_{level}" for level in range(NUM_LEVELS)]
TABLE_NAMES = list(LiftingTables._fields)


def pv_memory_names(config: DuoSpaceNetConfig) -> list[str]:
    """What the backbone graph leaves in memory, by decoder layer and level."""
    layers = range(config.num_layers) if config.attends_pv else ()
    return [f"pv_value_{layer}_{level}" for layer in layers for level in range(NUM_LEVELS)]


def bev_memory_names(config: DuoSpaceNetConfig) -> list[str]:
    """What the lifter graph leaves in memory, by decoder layer, or as a whole."""
    if config.fuses_bev:
        return ["bev"]
    return [f"bev_value_{layer}" for layer in range(config.num_layers)] if config.attends_bev else []


def memory_names(config: DuoSpaceNetConfig) -> list[str]:
    """All that a frame leaves in memory, in the order in which the decoder takes it."""
    return pv_memory_names(config) + bev_memory_names(config)


def window_names(config: DuoSpaceNetConfig) -> list[str]:
    """What the decoder must know of a window: of the cameras where it looks into PV, of time where poses move."""
    unread = set() if config.attends_pv else {"image_T_ego", "camera_valid"}
    unread |= set() if config.attends_pv or not config.fuses_bev else {"time_delta_s"}
    return [name for name in Window._fields if name not in unread]


@dataclass(frozen=True)
class Graph:
    """One graph: a module from tensors to tensors, and what it takes and gives by name, as tensors without data."""

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
    """The graphs of `model` in the order in which a frame passes them; a configuration may do without some.

    Shapes and types are those that a twin of the model without data takes and gives: nothing is computed.
    """
    config = model.config
    with torch.device("meta"):
        twin, known = DuoSpaceNet(config).eval(), _frame_inputs(config)
    graphs = []
    for real, shadow in zip(_wrappers(model), _wrappers(twin), strict=True):
        if real.name == "decoder":
            known = _window_inputs(config, known)
        taken = {name: known[name] for name in real.inputs}
        with torch.no_grad():
            given = dict(zip(real.outputs, shadow.module(*taken.values()), strict=True))
        graphs.append(Graph(real.name, real.module, taken, given))
        known |= given
    return graphs


@dataclass(frozen=True)
class _Wrapper:
    name: GraphName
    module: nn.Module
    inputs: list[str]
    outputs: list[str]


def _wrappers(model: DuoSpaceNet) -> list[_Wrapper]:
    config = model.config
    pv, bev = PV_NAMES if config.has_bev else [], ["bev"] if config.has_bev else []
    bev_memory = [name for name in bev_memory_names(config) if name not in bev]
    slots = [slot_name(slot, name) for slot in range(config.num_frames) for name in memory_names(config)]
    window, calibration = window_names(config), ["image_T_ego", "camera_valid"]
    all_graphs = [
        _Wrapper("projector", ProjectorGraph(model), calibration, TABLE_NAMES),
        _Wrapper("backbone", BackboneGraph(model), ["images"], pv + pv_memory_names(config)),
        _Wrapper("lifter", LifterGraph(model), PV_NAMES + TABLE_NAMES, bev + bev_memory),
        _Wrapper("decoder", DecoderGraph(model), window + slots, ["class_logits", "boxes"]),
        _Wrapper("segmenter", SegmenterGraph(model), ["bev"], list(config.map_classes)),
    ]
    needless = set() if config.has_bev else {"projector", "lifter"}
    needless |= set() if config.map_classes else {"segmenter"}
    return [graph for graph in all_graphs if graph.name not in needless]


class ProjectorGraph(nn.Module):
    """Calibration to lifting tables; runs when the calibration changes."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, image_T_ego: Tensor, camera_valid: Tensor) -> Sequence[Tensor]:
        return tuple(self.model.projector(image_T_ego, camera_valid))


class BackboneGraph(nn.Module):
    """Images to PV features, where anything is lifted from them, and to what they leave in memory."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, images: Tensor) -> Sequence[Tensor]:
        pv = self.model.image_encoder(images)
        values = (level for layer in self.model.decoder.remember_pv(pv) for level in layer)
        return (*pv, *values) if self.model.config.has_bev else tuple(values)


class LifterGraph(nn.Module):
    """PV features to BEV features, and to what they leave in memory beside themselves."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Sequence[Tensor]:
        bev = self.model.lift(list(inputs[:NUM_LEVELS]), LiftingTables(*inputs[NUM_LEVELS:]))
        return (bev, *(value for value in self.model.decoder.remember_bev(bev) if value is not bev))


class DecoderGraph(nn.Module):
    """The temporal window to class logits (Q, classes) and boxes (Q, 9) in the ego frame."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Sequence[Tensor]:
        config, names = self.model.config, window_names(self.model.config)
        window, values = dict(zip(names, inputs, strict=False)), inputs[len(names) :]
        unread = inputs[0].new_zeros(config.num_frames)
        size = len(values) // config.num_frames
        memory = [_frame_memory(values[i : i + size], config) for i in range(0, len(values), size)]
        prediction = self.model.detect(memory, Window(*(window.get(name, unread) for name in Window._fields)))[-1]
        return prediction.class_logits, decode_boxes(prediction.pose)


class SegmenterGraph(nn.Module):
    """BEV features to one mask of logits (1, 1, X, Y) a map class; runs when asked."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, bev: Tensor) -> Sequence[Tensor]:
        return tuple(self.model.segmentation(bev).values())


def _frame_memory(values: Sequence[Tensor], config: DuoSpaceNetConfig) -> FrameMemory:
    num_pv = len(pv_memory_names(config))
    pv = [list(values[i : i + NUM_LEVELS]) for i in range(0, num_pv, NUM_LEVELS)]
    return FrameMemory(pv, list(values[num_pv:]))


def _frame_inputs(config: DuoSpaceNetConfig) -> dict[str, Tensor]:
    """What comes with a frame, without data."""
    num_cameras, image = config.num_cameras, config.image
    return {
        "images": torch.empty(num_cameras, image.height_px, image.width_px, 3, dtype=torch.uint8),
        "image_T_ego": torch.empty(num_cameras, 3, 4),
        "camera_valid": torch.empty(num_cameras, dtype=torch.bool),
    }


def _window_inputs(config: DuoSpaceNetConfig, frame: dict[str, Tensor]) -> dict[str, Tensor]:
    """The same for the frames of a window, beside all that one frame knows."""
    size = config.num_frames
    return frame | {
        **{name: torch.stack([frame[name]] * size) for name in ("image_T_ego", "camera_valid")},
        "past_T_now": torch.empty(size, 4, 4, device="meta"),
        "time_delta_s": torch.empty(size, device="meta"),
        "frame_valid": torch.empty(size, dtype=torch.bool, device="meta"),
        **{slot_name(slot, name): frame[name] for slot in range(size) for name in memory_names(config)},
    }
