"""Whose names a checkpoint has: the wrappers around its tensors, and the layouts that are known."""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from torch import Tensor

LayoutName = Literal["own", "torchvision", "vovnet", "mmdetection3d"]

# Under these names trainings keep the weights, in a dictionary or as a prefix, the copy to deploy first. Beside the raw
# weights the average stands as "state_dict_ema" or "model_ema" (timm's `load_state_dict` prefers them in this order;
# torchvision's references write the latter), "ema_model" or "ema". mmengine's EMAHook is the other way round:
# `_swap_ema_state_dict` swaps the two before saving, so that "state_dict" is the average and "ema_state_dict" is raw.
# "module" is DataParallel's and torch's AveragedModel's, "_orig_mod" torch.compile's, "model" also Lightning's.
_COPIES = (
    *("state_dict_ema", "model_ema", "ema_model", "ema"),
    *("state_dict", "model_state_dict", "model", "module", "_orig_mod"),
    "ema_state_dict",
)
_COUNTERS = {"n_averaged", "steps"}  # of torch's AveragedModel and of mmengine's
_DEEPEST = 8  # a dictionary in a pickle may hold itself


class Unwrapped(NamedTuple):
    """Tensors by the innermost names; the wrappers from the outside in; full names of what was not taken; and what
    a person should know about that.
    """

    tensors: dict[str, Any]
    wrappers: tuple[str, ...]
    left_aside: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Layout:
    """A way to name the parts of a model.

    mark: starts of names that only this layout has. renames: patterns and what they become in our names, the first
    that matches counts. elsewhere: what belongs to parts that are not ours.
    """

    name: LayoutName
    mark: str
    renames: tuple[tuple[str, str], ...] = ()
    elsewhere: str | None = None

    def our_name(self, name: str) -> str | None:
        """Our name of a tensor; None where it belongs to a part that is not ours.

        What lies inside a mapped part and has no place there keeps its name, which is none of ours: left aside, it
        would leave the part computing something else than it was trained to.
        """
        if self.elsewhere and re.match(self.elsewhere, name):
            return None
        for pattern, ours in self.renames:
            if match := re.fullmatch(pattern, name):
                return match.expand(ours)
        return name


OWN = Layout("own", mark="")
# torchvision.models.resnet; `fc` is the classifier.
TORCHVISION = Layout(
    "torchvision",
    mark=r"(conv1|bn1|layer[1-4])\.",
    renames=((r"((?:conv1|bn1|layer[1-4])\..+)", r"image_encoder.backbone.\1"),),
    elsewhere=r"fc\.",
)


def _vovnet(around: str) -> Layout:
    """The names of a VoVNet, each behind the pattern `around`; where there is none, what belongs to it shows."""
    return Layout(
        "vovnet",
        mark=rf"{around}(stem\.stem_|stage\d\.OSA)",
        renames=((rf"{around}(.+)", r"image_encoder.backbone.\1"),),
        elsewhere=rf"(?!{around})" if around else r"(?!(stem|stage\d)\.)",
    )


# youngwanLEE/vovnet-detectron2: in its files and DD3D's, the ImageNet weights included, the network is `bottom_up` of
# an FPN that is `backbone` of a detector; heads stand beside it. PETR's family has it as mmdetection3d's img_backbone.
VOVNETS = tuple(_vovnet(around) for around in (r"backbone\.bottom_up\.", r"bottom_up\.", ""))
# A backbone and mmdetection's FPN (mmdet/models/necks/fpn.py) in an mmdetection3d detector, three levels and one extra
# convolution, as Sparse4D sets it. Heads, depth branches and view transformers stand beside them. ResNets have
# torchvision's names there, and DCNv2 its offsets inside the convolution (mmcv/ops/modulated_deform_conv.py,
# conv2.conv_offset); VoVNets have those above. Ours are the same, so the rest of a name passes as it is.
MMDETECTION3D = Layout(
    "mmdetection3d",
    mark=r"img_(backbone|neck)\.",
    renames=(
        (r"img_backbone\.(.+)", r"image_encoder.backbone.\1"),
        (r"img_neck\.lateral_convs\.(\d+)\.conv\.(weight|bias)", r"image_encoder.neck.lateral.\1.\2"),
        (r"img_neck\.fpn_convs\.3\.conv\.(weight|bias)", r"image_encoder.neck.extra.\1"),
        (r"img_neck\.fpn_convs\.(\d+)\.conv\.(weight|bias)", r"image_encoder.neck.output.\1.\2"),
    ),
    elsewhere=r"(?!img_(backbone|neck)\.)",
)


def recognise(names: Collection[str], expected: Collection[str]) -> Layout:
    """The layout of a file with these names; ours if any name is one of `expected`, or if nothing else fits."""
    if any(name in expected for name in names):
        return OWN
    for layout in (MMDETECTION3D, *VOVNETS, TORCHVISION):
        if any(re.match(layout.mark, name) for name in names):
            return layout
    return OWN


def unwrap(content: Any) -> Unwrapped:
    """Take the weights to deploy out of what a training saved: {"state_dict": {"module.conv1.weight": ...}, ...}."""
    wrappers: list[str] = []
    left_aside: list[str] = []
    notes: list[str] = []
    for _ in range(_DEEPEST):
        copies = _copies(content)
        if not copies:
            break
        taken, *others = copies
        path = ".".join([*wrappers, ""])
        left_aside += [path + name for name in _others(content, taken, others)]
        if others:
            notes.append(_choice(path + taken, [path + other for other in others]))
        wrappers.append(taken)
        content = copies[taken]
    doubles = _doubles(content) if is_state_dict(content) else set()
    if doubles:
        notes.append(_DOUBLES)
        left_aside += [".".join([*wrappers, name]) for name in content if name in doubles]
        content = {name: tensor for name, tensor in content.items() if name not in doubles}
    return Unwrapped(content, tuple(wrappers), tuple(left_aside), tuple(notes))


_DOUBLES = (
    "tensors ema_* stand beside those they are named after: the plain names were taken, which hold the average in a "
    "file that mmcv's EMAHook let be saved at the end of an epoch; saved between epochs, ema_* would hold it"
)


def _choice(taken: str, others: list[str]) -> str:
    swapped = ", which mmengine swaps with the average before it saves" if others[-1].endswith("ema_state_dict") else ""
    return f"the file holds several copies of the weights: took {taken}{swapped}; left {', '.join(others)} aside"


def _copies(content: Any) -> dict[str, Mapping]:
    """The copies of weights in a dictionary by name, the one to deploy first; none where it is the weights itself."""
    if not isinstance(content, Mapping):
        return {}
    groups = _by_first_word(content) if is_state_dict(content) else content
    copies = {name: groups[name] for name in _COPIES if isinstance(groups.get(name), Mapping)}
    return {name: copy for name, copy in copies.items() if _holds_tensors(copy)}


def _holds_tensors(content: Mapping) -> bool:
    """Some trainings write an empty copy, or the average's settings in its place."""
    return next(_tensor_names(content), None) is not None


def _by_first_word(tensors: Mapping[str, Tensor]) -> dict[str, dict[str, Tensor]]:
    """{"module.a": x} as {"module": {"a": x}}; nothing unless every name starts with that of a copy."""
    groups: dict[str, dict[str, Tensor]] = {}
    for name, tensor in tensors.items():
        first, _, rest = name.partition(".")
        if rest and first in _COPIES:
            groups.setdefault(first, {})[rest] = tensor
        elif name not in _COUNTERS:
            return {}
    return groups


def _others(content: Mapping, taken: str, others: list[str]) -> Iterator[str]:
    """Names of the tensors in a dictionary of copies that do not belong to the one taken."""
    if is_state_dict(content):
        yield from (name for name in content if not name.startswith(f"{taken}."))
    else:
        for other in others:
            yield from (f"{other}.{name}" for name in _tensor_names(content[other]))


def _tensor_names(content: Mapping, seen: frozenset[int] = frozenset()) -> Iterator[str]:
    for name, value in content.items():
        if isinstance(value, Tensor):
            yield str(name)
        elif isinstance(value, Mapping) and len(seen) < _DEEPEST and id(value) not in seen:
            yield from (f"{name}.{inner}" for inner in _tensor_names(value, seen | {id(value)}))


def _doubles(tensors: Mapping[str, Tensor]) -> set[str]:
    """mmcv's EMAHook registers the buffer ema_layer1_0_weight for the parameter layer1.0.weight."""
    return {f"ema_{name.replace('.', '_')}" for name in tensors} & tensors.keys()


def is_state_dict(content: Any) -> bool:
    """Whether this is a dictionary of named tensors and nothing else."""
    return isinstance(content, Mapping) and all(
        isinstance(name, str) and isinstance(value, Tensor) for name, value in content.items()
    )
