"""Data augmentation of clips: photometric and geometric. The paper uses neither.

Rotations and scalings of the ego frame, as in BEVDet, are left out. They are not exact: masks would have to be
resampled, and objects that enter the range are not always annotated.
"""

from dataclasses import dataclass

import numpy as np
import torch

from ...model import DuoSpaceNetConfig
from ...runtime.frame import Frame
from ..settings import Settings
from .image_transform import Array, sample_image_transform, transform_image
from .mirrored_frame import mirror_frame
from .photometric_distortion import PhotometricDistortion, sample_photometric_distortion
from .training_frames import TrainingFrame

_STREAM = 2  # number of the random stream, see `past_frames`


@dataclass(frozen=True)
class Augmentation:
    """The augmentation of one clip. All frames of a clip have the same, as if they came from one rig.

    distortions: the photometric distortion of each camera; empty = none.
    image_transforms: `new_T_old` (3, 3) of each camera's network image; empty = none.
    mirrored: whether the frames are mirrored, see `mirror_frame`.
    fill: (3) uint8, the colour around transformed images (BGR).
    """

    distortions: tuple[PhotometricDistortion, ...]
    image_transforms: tuple[Array, ...]
    mirrored: bool
    fill: np.ndarray

    def mirror(self, frame: Frame) -> Frame:
        """Mirror a frame, or return it as it is."""
        return mirror_frame(frame) if self.mirrored else frame

    def augment_images(self, frame: TrainingFrame) -> TrainingFrame:
        """Distort and transform the images of a training frame. Its projections are adapted. It is not changed."""
        if not self.distortions and not self.image_transforms:
            return frame
        images, projections = frame.images.numpy().copy(), frame.image_T_ego.numpy().copy()
        for camera in range(len(images)):
            if self.image_transforms:
                new_T_old = self.image_transforms[camera]
                projections[camera] = new_T_old @ projections[camera].astype(np.float64)
            if frame.camera_valid[camera]:
                images[camera] = self._augment(images[camera], camera)
        return frame._replace(images=torch.from_numpy(images), image_T_ego=torch.from_numpy(projections))

    def _augment(self, image: np.ndarray, camera: int) -> np.ndarray:
        if self.distortions:
            image = self.distortions[camera](image)
        if self.image_transforms:
            image = transform_image(image, self.image_transforms[camera], self.fill)
        return image


def sample_augmentation(settings: Settings, config: DuoSpaceNetConfig, clip: int) -> Augmentation:
    """Sample the augmentation of clip number `clip`. It depends on the settings and this number only."""
    rng = np.random.default_rng([settings.seed, clip, _STREAM])
    image, cameras = config.image, range(config.num_cameras)
    distortions = tuple(sample_photometric_distortion(rng) for _ in cameras) if settings.photometric else ()
    transforms: tuple[Array, ...] = ()
    mirrored = False
    if settings.geometric:
        transforms = tuple(sample_image_transform(image.width_px, image.height_px, rng) for _ in cameras)
        mirrored = bool(rng.random() < 0.5) and can_mirror(config)
    # The configured mean is in the channel order of the encoder.
    mean = image.mean[::-1] if image.colour_order == "rgb" else image.mean
    return Augmentation(distortions, transforms, mirrored, np.rint(mean).clip(0, 255).astype(np.uint8))


def can_mirror(config: DuoSpaceNetConfig) -> bool:
    """Whether mirrored frames have the same range: it must be symmetric in y."""
    return config.voxels.lower_m[1] == -config.voxels.upper_m[1]
