"""The graphs of a bundle: one thin wrapper module around the model per graph, with named inputs and outputs."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNet, DuoSpaceNetConfig
from ..model.decoder import FrameCache
from ..model.image_encoder import NUM_LEVELS, ImageEncoder
from ..model.lifter import LiftingTables
from ..model.pose_vectors import decode_boxes
from ..model.window import Window
from ..runtime.bundle.manifest import GraphName, slot_name
from .rewrites import rewrite

REDUCED_NAMES = [f"reduced_pv_{level}" for level in range(NUM_LEVELS)]
TABLE_NAMES = list(LiftingTables._fields)
# Up to this size the cameras are encoded together. Larger images leave onnxruntime's caches, so that one camera at a
# time takes less time.
_LARGEST_IMAGE_TOGETHER_PX = 2**17


@dataclass(frozen=True)
class Graph:
    """One graph: its module, and its inputs and outputs by name, in the module's order.

    The tensors are on the meta device: they have shapes and types, but no data.
    """

    name: GraphName
    module: nn.Module
    inputs: dict[str, Tensor]
    outputs: dict[str, Tensor]

    @property
    def model(self) -> DuoSpaceNet:
        """The model that the module wraps."""
        model = self.module.get_submodule("model")
        assert isinstance(model, DuoSpaceNet)
        return model

    @torch.no_grad()
    def __call__(self, inputs: dict[str, Tensor]) -> dict[str, Tensor]:
        """Run the module in eager mode on inputs by name; returns the outputs by name."""
        outputs = self.module(*(inputs[name] for name in self.inputs))
        return dict(zip(self.outputs, outputs, strict=True))


def build_graphs(model: DuoSpaceNet, cameras_per_run: int | None = None) -> list[Graph]:
    """The graphs of `model`, in the order in which they run for a frame.

    cameras_per_run: the number of cameras that the backbone takes at a time; None for all.

    A configuration without BEV has no projector and lifter. One without map classes has no segmenter.
    """
    config = model.config
    frame_tensors = _frame_tensors(config, config.num_cameras)
    backbone_tensors = _frame_tensors(config, cameras_per_run) if cameras_per_run else frame_tensors
    decoder_tensors = window_tensors(config) | _slot_tensors(config, frame_tensors)
    graphs = []
    for wrapper in _wrappers(model):
        tensors = backbone_tensors if wrapper.name == "backbone" else frame_tensors
        inputs = {name: (decoder_tensors if wrapper.name == "decoder" else tensors)[name] for name in wrapper.inputs}
        outputs = {name: tensors[name] for name in wrapper.outputs}
        graphs.append(Graph(wrapper.name, wrapper.module, inputs, outputs))
    return graphs


def graphs_to_export(model: DuoSpaceNet) -> list[Graph]:
    """The graphs in the form in which a bundle holds them: with less arithmetic, and equal results.

    The model is rewritten. If its images are large, the backbone takes one camera at a time.
    """
    image = model.config.image
    is_large = image.width_px * image.height_px > _LARGEST_IMAGE_TOGETHER_PX
    return build_graphs(rewrite(model), 1 if is_large else None)


@dataclass(frozen=True)
class _Wrapper:
    """A graph's module, and the names of its inputs and outputs in the module's order."""

    name: GraphName
    module: nn.Module
    inputs: list[str]
    outputs: list[str]


def _wrappers(model: DuoSpaceNet) -> list[_Wrapper]:
    """The wrappers of the graphs that the configuration needs, in the order in which they run for a frame."""
    config = model.config
    reduced, bev = REDUCED_NAMES if config.has_bev else [], ["bev"] if config.has_bev else []
    bev_cached = [name for name in bev_cached_names(config) if name not in bev]
    slots = [slot_name(slot, name) for slot in range(config.num_frames) for name in cached_names(config)]
    window, calibration = window_names(config), ["image_T_ego", "camera_valid"]
    all_graphs = [
        _Wrapper("projector", ProjectorGraph(model), calibration, TABLE_NAMES),
        _Wrapper("backbone", BackboneGraph(model), ["images"], reduced + pv_cached_names(config)),
        _Wrapper("lifter", LifterGraph(model), REDUCED_NAMES + TABLE_NAMES, bev + bev_cached),
        _Wrapper("decoder", DecoderGraph(model), window + slots, ["class_logits", "boxes"]),
        _Wrapper("segmenter", SegmenterGraph(model), ["bev"], list(config.map_classes)),
    ]
    unneeded = set() if config.has_bev else {"projector", "lifter"}
    unneeded |= set() if config.map_classes else {"segmenter"}
    return [graph for graph in all_graphs if graph.name not in unneeded]


class ProjectorGraph(nn.Module):
    """Computes the lifting tables from the calibration. Runs when the calibration or the valid cameras change."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, image_T_ego: Tensor, camera_valid: Tensor) -> Sequence[Tensor]:
        return tuple(self.model.projector(image_T_ego, camera_valid))


class BackboneGraph(nn.Module):
    """Computes the cached PV attention values from the images, and the levels for the lifter if the model has BEV.

    The images are those of all cameras, or of some consecutive ones.
    """

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, images: Tensor) -> Sequence[Tensor]:
        pv = self.model.image_encoder(images)
        values = [level for layer in self.model.decoder.cache_pv(pv) for level in layer]
        return (*self.model.lifter.reduce(pv), *values) if self.model.config.has_bev else tuple(values)


class LifterGraph(nn.Module):
    """Computes the BEV features and the cached BEV attention values from the reduced levels and the lifting tables."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Sequence[Tensor]:
        bev = self.model.lift(list(inputs[:NUM_LEVELS]), LiftingTables(*inputs[NUM_LEVELS:]))
        # With a BEV fusion the cached value is `bev` itself. A graph must not have the same output twice.
        return (bev, *(value for value in self.model.decoder.cache_bev(bev) if value is not bev))


class DecoderGraph(nn.Module):
    """Computes class logits (Q, classes) and boxes (Q, 9) in the ego frame from the temporal window.

    The inputs are the fields of `Window` in `window_names`, then the cached values of every slot.
    """

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, *inputs: Tensor) -> Sequence[Tensor]:
        config, names = self.model.config, window_names(self.model.config)
        window, values = dict(zip(names, inputs, strict=False)), inputs[len(names) :]
        # Zeros for the fields without an input. Such a model uses no camera field, and time_delta_s of slot 0 only,
        # which is always 0.
        unused = inputs[0].new_zeros(config.num_frames)
        size = len(values) // config.num_frames
        caches = [_frame_cache(values[i : i + size], config) for i in range(0, len(values), size)]
        prediction = self.model.detect(caches, Window(*(window.get(name, unused) for name in Window._fields)))[-1]
        return prediction.class_logits, decode_boxes(prediction.pose)


class SegmenterGraph(nn.Module):
    """Computes one map of logits (1, 1, X, Y) per map class from the BEV features. Runs only if maps are requested."""

    def __init__(self, model: DuoSpaceNet) -> None:
        super().__init__()
        self.model = model

    def forward(self, bev: Tensor) -> Sequence[Tensor]:
        return tuple(self.model.segmentation(bev).values())


def pv_cached_names(config: DuoSpaceNetConfig) -> list[str]:
    """Names of the cached PV attention values, one per decoder layer and level; outputs of the backbone graph."""
    layers = range(config.num_layers) if config.attends_pv else ()
    return [f"pv_value_{layer}_{level}" for layer in layers for level in range(NUM_LEVELS)]


def bev_cached_names(config: DuoSpaceNetConfig) -> list[str]:
    """Names of the cached BEV values; outputs of the lifter graph.

    They are attention values, one per decoder layer. With a BEV fusion they are the BEV features alone.
    """
    if config.fuses_bev:
        return ["bev"]
    return [f"bev_value_{layer}" for layer in range(config.num_layers)] if config.attends_bev else []


def cached_names(config: DuoSpaceNetConfig) -> list[str]:
    """Names of all values that are cached per frame, in the order of the decoder's inputs."""
    return pv_cached_names(config) + bev_cached_names(config)


def window_names(config: DuoSpaceNetConfig) -> list[str]:
    """Names of the `Window` fields that the decoder of `config` uses.

    Only PV attention needs the calibration. A model that attends to BEV alone and fuses the BEV features of the window
    uses the current poses only, so it needs no time differences.
    """
    unused = set() if config.attends_pv else {"image_T_ego", "camera_valid"}
    unused |= set() if config.attends_pv or not config.fuses_bev else {"time_delta_s"}
    return [name for name in Window._fields if name not in unused]


def _frame_cache(values: Sequence[Tensor], config: DuoSpaceNetConfig) -> FrameCache:
    """Group the cached values of one frame, which are in the order of `cached_names`."""
    num_pv = len(pv_cached_names(config))
    pv = [list(values[i : i + NUM_LEVELS]) for i in range(0, num_pv, NUM_LEVELS)]
    return FrameCache(pv, list(values[num_pv:]))


def _frame_tensors(config: DuoSpaceNetConfig, num_cameras: int) -> dict[str, Tensor]:
    """All inputs and outputs of the graphs for some cameras of a single frame, by name, on the meta device."""
    image, (num_x, num_y, num_z) = config.image, config.voxels.size
    bev, num_voxels = (1, config.channels, num_x, num_y), num_z * num_x * num_y
    # On the meta device the image encoder computes only shapes.
    with torch.device("meta"), torch.no_grad():
        images = torch.empty(num_cameras, image.height_px, image.width_px, 3, dtype=torch.uint8)
        values = ImageEncoder(config).eval()(images)
        return {
            "images": images,
            "image_T_ego": torch.empty(num_cameras, 3, 4),
            "camera_valid": torch.empty(num_cameras, dtype=torch.bool),
            "voxel_locations": torch.empty(num_cameras, 2, num_voxels),
            "voxel_visible": torch.empty(num_cameras, num_voxels, dtype=torch.bool),
            **{
                name: torch.empty(num_cameras, config.voxel_channels, *level.shape[2:])
                for name, level in zip(REDUCED_NAMES, values, strict=True)
            },
            # The names are ordered by layer, then by level. There are none without PV attention.
            **dict(zip(pv_cached_names(config), values * config.num_layers, strict=False)),
            "bev": torch.empty(bev),
            **{name: torch.empty(bev) for name in bev_cached_names(config)},
            **result_tensors(config),
        }


def window_tensors(config: DuoSpaceNetConfig) -> dict[str, Tensor]:
    """The fields of `Window` by name, in their order, on the meta device."""
    size, num_cameras = config.num_frames, config.num_cameras
    with torch.device("meta"):
        return {
            "image_T_ego": torch.empty(size, num_cameras, 3, 4),
            "past_T_now": torch.empty(size, 4, 4),
            "time_delta_s": torch.empty(size),
            "frame_valid": torch.empty(size, dtype=torch.bool),
            "camera_valid": torch.empty(size, num_cameras, dtype=torch.bool),
        }


def result_tensors(config: DuoSpaceNetConfig) -> dict[str, Tensor]:
    """The results of a frame by name, on the meta device: class logits, boxes, and a map of logits per map class."""
    num_x, num_y, _ = config.voxels.size
    with torch.device("meta"):
        return {
            "class_logits": torch.empty(config.num_queries, len(config.classes)),
            "boxes": torch.empty(config.num_queries, 9),
            **{name: torch.empty(1, 1, num_x, num_y) for name in config.map_classes},
        }


def _slot_tensors(config: DuoSpaceNetConfig, frame_tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The cached values of all slots of the window by name, on the meta device."""
    slots = range(config.num_frames)
    return {slot_name(slot, name): frame_tensors[name] for slot in slots for name in cached_names(config)}
