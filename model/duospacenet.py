"""DuoSpaceNet, with the structure of the paper's framework figure."""

from typing import NamedTuple

from torch import Tensor, nn

from .bev_encoder import FeatureDivergenceEnhancement, HeightReduction
from .config import DuoSpaceNetConfig
from .decoder import DuoSpaceDecoder, FrameCache, Prediction
from .image_encoder import ImageEncoder
from .lifter import Lifter, LiftingTables, Projector
from .queries import DuoSpaceQueries
from .segmentation import MapSegmentation
from .window import Window


class FrameFeatures(NamedTuple):
    """The features of one frame: F_PV^j (N, C, H_j, W_j), and F_BEV (1, C, X, Y) if the model uses it."""

    pv: list[Tensor]
    bev: Tensor | None


class Output(NamedTuple):
    """The result for a window.

    predictions: one per decoder layer. The last one is the final prediction.
    maps: logits (1, 1, X, Y) by map class.
    """

    predictions: list[Prediction]
    maps: dict[str, Tensor]


class DuoSpaceNet(nn.Module):
    """3D detection and map segmentation from the surround cameras of a temporal window.

    The model has no state: the window is an argument. `forward` takes the images of a whole window. For a stream, call
    `encode` and `cache_frame` once per frame, keep the cached values, and call `detect` on the window.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.config = config
        self.image_encoder = ImageEncoder(config)
        if config.has_bev:
            enhancement = FeatureDivergenceEnhancement if config.divergence_enhancement else HeightReduction
            self.projector = Projector(config)
            self.lifter = Lifter(config)
            self.divergence_enhancement = enhancement(config)
        self.queries = DuoSpaceQueries(config)
        self.decoder = DuoSpaceDecoder(config)
        if config.map_classes:
            self.segmentation = MapSegmentation(config)

    def forward(
        self,
        images: Tensor,
        image_T_ego: Tensor,
        past_T_now: Tensor,
        time_delta_s: Tensor,
        frame_valid: Tensor,
        camera_valid: Tensor,
    ) -> Output:
        """Detect objects and segment the map from the images of a window.

        images (T, N, H, W, 3) uint8 BGR, index 0 the current frame.
        The other arguments are the fields of `Window`, with their shapes and units.
        """
        features = [self.encode(*frame) for frame in zip(images, image_T_ego, camera_valid, strict=True)]
        caches = [self.cache_frame(frame) for frame in features]
        window = Window(image_T_ego, past_T_now, time_delta_s, frame_valid, camera_valid)
        return Output(self.detect(caches, window), self.segment_map(features[0]))

    def encode(self, images: Tensor, image_T_ego: Tensor, camera_valid: Tensor) -> FrameFeatures:
        """Compute the features of one frame.

        images (N, H, W, 3) uint8 BGR.
        image_T_ego (N, 3, 4) [px]: from the ego frame to pixels of the images.
        camera_valid (N) bool: False for a lost camera.
        """
        pv = self.image_encoder(images)
        if not self.config.has_bev:
            return FrameFeatures(pv, None)
        return FrameFeatures(pv, self.lift(self.lifter.reduce(pv), self.projector(image_T_ego, camera_valid)))

    def lift(self, levels: list[Tensor], tables: LiftingTables) -> Tensor:
        """Convert the levels from `lifter.reduce` to F_BEV (1, C, X, Y)."""
        return self.divergence_enhancement(self.lifter(levels, tables))

    def cache_frame(self, features: FrameFeatures) -> FrameCache:
        """Compute the cached values of a frame, which the decoder uses for this frame and the next T - 1."""
        bev = [] if features.bev is None else self.decoder.cache_bev(features.bev)
        return FrameCache(self.decoder.cache_pv(features.pv), bev)

    def detect(self, caches: list[FrameCache], window: Window) -> list[Prediction]:
        """Detect the objects of the current frame.

        caches: the cached values of T frames, index 0 the current frame.

        Returns one prediction per decoder layer. The last one is the final prediction.
        """
        return self.decoder(*self.queries(), caches, window)

    def segment_map(self, features: FrameFeatures) -> dict[str, Tensor]:
        """Segment the map of a frame: logits (1, 1, X, Y) by map class."""
        return self.segmentation(features.bev) if self.config.map_classes else {}
