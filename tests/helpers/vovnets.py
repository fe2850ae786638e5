"""What the tests of VoVNet share: small networks, and the names and shapes that are published."""

from dataclasses import replace

from duospacenet.model import PRESETS
from duospacenet.model.config import VoVNetConfig

# Every number of channels is another, and a stage with one, one with two and one with three modules.
SMALL = VoVNetConfig(
    stem=(6, 7, 8), depths=(1, 2, 3, 1), widths=(4, 5, 6, 7), out_channels=(9, 10, 11, 12), num_convolutions=2
)
# 80 rows are 20, 10, 5 and 2, and 208 columns 52, 26, 13 and 6 from C2 to C5: even sizes are halved, odd ones cut.
TINY = replace(
    PRESETS["tiny"],
    preset="tiny-vovnet",
    image=replace(PRESETS["large"].image, width_px=208, height_px=80),
    backbone=SMALL,
    num_layers=1,
)


def published_shapes(config: VoVNetConfig) -> dict[str, tuple[int, ...]]:
    """The state dict of youngwanLEE/vovnet-detectron2's network, name by name, by the rule in its vovnet.py."""
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
