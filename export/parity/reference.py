"""The reference of the parity check: the model in eager mode, frame by frame, with its own cached values."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from numpy.typing import NDArray
from torch import Tensor

from ...model import DuoSpaceNet
from ...model.window import Window
from ...runtime import Frame
from ...runtime.bundle.manifest import GraphName, slot_name
from ...runtime.geometry import inverse, nearest_rigid
from ...runtime.preprocessing import NetworkInputs, prepare
from ...weights.input_contract import preprocessing
from ..graphs import Graph, build_graphs, cached_names


class GraphRun(NamedTuple):
    """The inputs and outputs of one graph for one frame, by name.

    heading: the lengths (Q) of the vectors (sin θ, cos θ) of the boxes; None if there are no boxes, or if they are not
        known.
    """

    inputs: dict[str, Tensor]
    outputs: dict[str, Tensor]
    heading: Tensor | None = None

    def heading_array(self) -> NDArray | None:
        """`heading` on the CPU."""
        return None if self.heading is None else self.heading.cpu().numpy()


class EagerReference:
    """Runs the graphs' modules in PyTorch, frame by frame.

    Nothing comes from a bundle: the preprocessing is that of the model's configuration, and the caller gives the window
    of each frame. The relative poses and times are computed here, so that an error of the runtime's history is
    detected.
    """

    def __init__(self, model: DuoSpaceNet) -> None:
        self.model = model.eval()
        self.config = model.config
        self.graphs: dict[GraphName, Graph] = {graph.name: graph for graph in build_graphs(model)}
        self._preprocessing = preprocessing(model.config)
        self._device = next(model.parameters()).device
        self._cache: dict[int, tuple[NetworkInputs, dict[str, Tensor]]] = {}

    def step(self, frames: Sequence[Frame], window: Sequence[int]) -> dict[str, GraphRun]:
        """Run every graph for the newest frame of `window`; returns their inputs and outputs by graph.

        window: indices into `frames`, newest first. Earlier calls must have run its older frames.
        """
        now = frames[window[0]]
        prepared = prepare(now, self._preprocessing, self.config.num_cameras)
        tensors = {name: torch.from_numpy(array) for name, array in prepared._asdict().items()}
        runs: dict[str, GraphRun] = {}
        for name in (name for name in self.graphs if name != "decoder"):
            runs[name] = self.run(name, tensors)
            tensors |= runs[name].outputs
        self._update_cache(window, prepared, tensors)
        runs["decoder"] = self.run("decoder", self._decoder_inputs(frames, window))
        return runs

    def run(self, name: GraphName, tensors: Mapping[str, Tensor]) -> GraphRun:
        """Run one graph on the device of the model. tensors: its inputs by name; others are ignored."""
        graph = self.graphs[name]
        inputs = {key: tensors[key].to(self._device) for key in graph.inputs}
        if name != "decoder":
            return GraphRun(inputs, graph(inputs))
        poses: list[Tensor] = []
        heads = self.model.decoder.layers[-1].get_submodule("heads")
        with heads.register_forward_hook(lambda _module, _inputs, prediction: poses.append(prediction.pose)):
            outputs = graph(inputs)
        return GraphRun(inputs, outputs, heading=poses[-1][:, 6:8].norm(dim=-1))

    def _update_cache(self, window: Sequence[int], prepared: NetworkInputs, tensors: dict[str, Tensor]) -> None:
        """Keep the values of the frames in `window` and add those of the newest frame."""
        values = {name: tensors[name] for name in cached_names(self.config)}
        self._cache = {index: cached for index, cached in self._cache.items() if index in window}
        self._cache[window[0]] = prepared, values

    def _decoder_inputs(self, frames: Sequence[Frame], window: Sequence[int]) -> dict[str, Tensor]:
        specs, now = self.graphs["decoder"].inputs, frames[window[0]]
        inputs = {
            name: torch.zeros(spec.shape, dtype=spec.dtype) for name, spec in specs.items() if name in Window._fields
        }
        inputs["past_T_now"][:] = torch.eye(4)
        for slot, index in enumerate(window):
            past, (prepared, values) = frames[index], self._cache[index]
            past_T_now = inverse(nearest_rigid(past.global_T_ego)) @ nearest_rigid(now.global_T_ego)
            slot_inputs = {
                "image_T_ego": torch.from_numpy(prepared.image_T_ego),
                "camera_valid": torch.from_numpy(prepared.camera_valid),
                "frame_valid": torch.tensor(True),
                # The product above is the identity up to rounding only. The runtime sets slot 0 to the identity.
                "past_T_now": torch.from_numpy(past_T_now) if slot > 0 else torch.eye(4),
                "time_delta_s": torch.tensor(now.timestamp_s - past.timestamp_s),
            }
            for name in slot_inputs.keys() & inputs.keys():
                inputs[name][slot] = slot_inputs[name]
            inputs |= {slot_name(slot, name): value for name, value in values.items()}
        return {name: torch.zeros(spec.shape) if name not in inputs else inputs[name] for name, spec in specs.items()}
