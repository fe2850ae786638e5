"""The preprocessing in a bundle's manifest: how a camera image becomes an input image of the backbone."""

from typing import Annotated, Literal

from pydantic import Field

from ..json_record import FiniteFloat, JsonRecord, PositiveFloat
from .schema_versions import Since

Length = Annotated[int, Field(strict=True, gt=0, le=2**16)]  # in pixels or voxels


class Normalisation(JsonRecord):
    """The normalisation in the backbone graph: channels in `colour_order`, then (pixel - mean) / std.

    colour_order: of the network, and of `mean` and `std`. The graph converts from the order of `images` itself.
    mean, std: for pixels from 0 to 255.
    """

    colour_order: Literal["rgb", "bgr"]
    mean: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    std: tuple[PositiveFloat, PositiveFloat, PositiveFloat]


class Preprocessing(JsonRecord):
    """How a camera image of W0×H0 pixels becomes an input image of W×H = width_px × height_px pixels.

    The intrinsics must be adapted accordingly.
    colour_order: of the channels of `images`, the backbone's input, whatever the order of the network.
    scaling: "cover": by max(W / W0, H / H0), so that the scaled image covers the input.
    size_rounding: "half to even": of the scaled width Ws and height Hs, as in IEEE 754.
    resize_shrinking, resize_enlarging: the kernel for Ws < W0, and for Ws >= W0. Halvings since schema 4.
    crop: the columns in the centre and the rows at the bottom remain.
    crop_rounding: "down": of the (Ws - W) / 2 columns that are cropped on the left.
    pixel_centres: "at halves": the centre of the first pixel is (0.5, 0.5), in the camera image and in the input.
    normalisation_in_graph: part of the backbone; for information.

    The rules without numbers were the same in every schema. Since schema 5 they are in the file.
    """

    width_px: Length
    height_px: Length
    colour_order: Literal["bgr"]
    scaling: Annotated[Literal["cover"], Since(5)] = "cover"
    size_rounding: Annotated[Literal["half to even"], Since(5)] = "half to even"
    resize_shrinking: Literal["area", "area by halvings"]
    resize_enlarging: Literal["linear"]
    crop: Literal["centre columns, bottom rows"]
    crop_rounding: Annotated[Literal["down"], Since(5)] = "down"
    pixel_centres: Annotated[Literal["at halves"], Since(5)] = "at halves"
    normalisation_in_graph: Normalisation
