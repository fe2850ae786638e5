"""Small VoVNets for tests, and the published names and shapes of VoVNets."""

from dataclasses import replace

from duospacenet.model import PRESETS
from duospacenet.model.config import VoVNetConfig

# All numbers of channels differ, and there are stages with one, two and three modules.
SMALL = VoVNetConfig(
    stem=(6, 7, 8), depths=(1, 2, 3, 1), widths=(4, 5, 6, 7), out_channels=(9, 10, 11, 12), num_convolutions=2
)
# From C2 to C5, 80 rows become 20, 10, 5 and 2, and 208 columns 52, 26, 13 and 6: even and odd sizes are halved.
TINY = replace(
    PRESETS["tiny"],
    preset="tiny-vovnet",
    image=replace(PRESETS["large"].image, width_px=208, height_px=80),
    backbone=SMALL,
    num_layers=1,
)


def published_shapes(config: VoVNetConfig) -> dict[str, tuple[int, ...]]:
    """The names and shapes of the state dict in youngwanLEE/vovnet-detectron2, by the rules of its vovnet.py."""
    shapes: dict[str, tuple[int, ...]] = {}
    channels = 3
    for number, width in enumerate(config.stem, start=1):
        shapes |= _convolution(f"stem.stem_{number}", width, channels, 3)
        channels = width
    for stage in (2, 3, 4, 5):
        depth, width, out = config.depths[stage - 2], config.widths[stage - 2], config.out_channels[stage - 2]
        for number in range(1, depth + 1):
            name = f"OSA{stage}_{number}"
            module = f"stage{stage}.{name}"
            for index in range(config.num_convolutions):
                inputs = channels if index == 0 else width
                shapes |= _convolution(f"{module}.layers.{index}.{name}_{index}", width, inputs, 3)
            total = channels + config.num_convolutions * width
            shapes |= _convolution(f"{module}.concat.{name}_concat", out, total, 1)
            shapes |= {f"{module}.ese.fc.weight": (out, out, 1, 1), f"{module}.ese.fc.bias": (out,)}
            channels = out
    return shapes


def _convolution(name: str, out: int, inputs: int, size: int) -> dict[str, tuple[int, ...]]:
    numbers = ("weight", "bias", "running_mean", "running_var")
    norm = {f"{name}/norm.{number}": (out,) for number in numbers}
    return {f"{name}/conv.weight": (out, inputs, size, size), **norm, f"{name}/norm.num_batches_tracked": ()}
