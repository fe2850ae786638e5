"""Layouts: the naming schemes of known code bases, and their translation to this toolkit's tensor names."""

import re
from collections.abc import Collection
from dataclasses import dataclass

from ..runtime.bundle.manifest import LayoutName


@dataclass(frozen=True)
class Layout:
    """The naming scheme of one code base.

    name: the name of the layout in reports and manifests.
    mark: a pattern. A file with a tensor name that starts with it can have this layout.
    renames: pairs of a pattern and its replacement, which is our name. The first pattern that matches the whole name
        applies.
    ignored: a pattern. Names that start with it belong to parts that this toolkit does not have, such as other heads.
    bare: whether the mark is the start of a backbone's own names, which also occur inside other networks. An unknown
        prefix in front of such names is then not taken for a wrapper.
    """

    name: LayoutName
    mark: str
    renames: tuple[tuple[str, str], ...] = ()
    ignored: str | None = None
    bare: bool = False

    def our_name(self, name: str) -> str | None:
        """Our name of a tensor, or None if it belongs to a part that this toolkit does not have.

        A tensor of a part that we do have, but without a counterpart in our part, keeps its name. It is then reported
        as unexpected: without it, our part would compute other features than it was trained for.
        """
        if self.ignored and re.match(self.ignored, name):
            return None
        for pattern, replacement in self.renames:
            if match := re.fullmatch(pattern, name):
                return match.expand(replacement)
        return name


# Loss functions and metrics keep class weights, confusion matrices and the like as buffers. Inference never uses them.
_LOSS_OR_METRIC = r"([^.]+_)?(criterion|criteria|loss|losses|metric|metrics)(_[^.]+)?\."

OWN = Layout("own", mark="", ignored=_LOSS_OR_METRIC)
# torchvision.models.resnet. `fc` is the classifier.
TORCHVISION = Layout(
    "torchvision",
    mark=r"(conv1|bn1|layer[1-4])\.",
    renames=((r"((?:conv1|bn1|layer[1-4])\..+)", r"image_encoder.backbone.\1"),),
    ignored=rf"fc\.|{_LOSS_OR_METRIC}",
    bare=True,
)


def _vovnet(prefix: str) -> Layout:
    """The layout of a VoVNet with a prefix in its names. Without a prefix, only `stem` and `stage*` belong to it."""
    return Layout(
        "vovnet",
        mark=rf"{prefix}(stem\.stem_|stage\d\.OSA)",
        renames=((rf"{prefix}(.+)", r"image_encoder.backbone.\1"),),
        ignored=rf"(?!{prefix})" if prefix else r"(?!(stem|stage\d)\.)",
        bare=not prefix,
    )


def _mmdetection(prefix: str, mark: str) -> Layout:
    """The layout of a backbone and mmdetection's FPN (mmdet/models/necks/fpn.py) in a detector.

    The model uses four levels of the FPN: three of the backbone's, and one extra convolution. Further levels, as in
    FCOS3D's five, are computed from the fourth and change nothing in the first four.
    """
    return Layout(
        "mmdetection3d",
        mark=mark,
        renames=(
            (rf"{prefix}backbone\.(.+)", r"image_encoder.backbone.\1"),
            (rf"{prefix}neck\.lateral_convs\.(\d+)\.conv\.(weight|bias)", r"image_encoder.neck.lateral.\1.\2"),
            (rf"{prefix}neck\.fpn_convs\.3\.conv\.(weight|bias)", r"image_encoder.neck.extra.\1"),
            (rf"{prefix}neck\.fpn_convs\.(\d+)\.conv\.(weight|bias)", r"image_encoder.neck.output.\1.\2"),
        ),
        ignored=rf"(?!{prefix}(backbone|neck)\.)|{prefix}neck\.fpn_convs\.([4-9]|\d\d+)\.conv\.(weight|bias)$",
    )


# youngwanLEE/vovnet-detectron2. In its files and in those of DD3D, the ImageNet weights included, the network is the
# `bottom_up` of an FPN, which is the `backbone` of a detector. The PETR family has it as mmdetection3d's img_backbone.
VOVNETS = tuple(_vovnet(prefix) for prefix in (r"backbone\.bottom_up\.", r"bottom_up\.", ""))
# The image branch of a multi-camera detector, as in Sparse4D and BEVFormer. Inside the backbone the names equal ours:
# torchvision's in a ResNet, with the offsets of a DCNv2 as conv2.conv_offset (mmcv/ops/modulated_deform_conv.py), and
# a VoVNet's as above.
MMDETECTION3D = _mmdetection("img_", mark=r"img_(backbone|neck)\.")
# A detector of single images, such as FCOS3D, which the paper starts from. LiDAR detectors use the same two words for
# networks of other kinds, so the mark also needs a name inside the backbone or the FPN.
FCOS3D = _mmdetection(
    "", mark=r"backbone\.(conv1\.|bn1\.|layer[1-4]\.|stem\.stem_|stage\d\.OSA)|neck\.(lateral|fpn)_convs\.\d"
)
FOREIGN_LAYOUTS = (MMDETECTION3D, FCOS3D, *VOVNETS, TORCHVISION)  # the first whose mark occurs applies


def recognise_layout(names: Collection[str], expected: Collection[str]) -> Layout:
    """The layout of a file with the tensor names `names`.

    expected: the names of the model's tensors. If the file has one of them, or if no other layout fits, it has our own
        layout.
    """
    if any(name in expected for name in names):
        return OWN
    for layout in FOREIGN_LAYOUTS:
        if any(re.match(layout.mark, name) for name in names):
            return layout
    return OWN
