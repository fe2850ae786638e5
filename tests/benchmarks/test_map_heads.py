"""The map heads are trained on fixed features, and nothing else changes."""

import pytest
import torch

from benchmarks.map_heads import LOSSES, bev_features, learning_rate_factor, train_segmentation
from duospacenet.model import PRESETS, DuoSpaceNet
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.training import initialise
from duospacenet.training.losses.frame_losses import map_losses
from duospacenet.training.samples.training_frames import make_training_frame
from duospacenet.weights.input_contract import preprocessing

TINY = PRESETS["tiny"]


def loss_of(model, features, frames):
    """The map losses in evaluation mode, summed over the frames."""
    with torch.no_grad():
        logits = [model.segmentation(feature.float()) for feature in features]
    pairs = zip(logits, frames, strict=True)
    return sum(float(sum(map_losses(maps, frame.maps, frame.map_known, LOSSES).values())) for maps, frame in pairs)


def test_the_segmentation_learns_the_maps_and_the_other_parts_stay(tmp_path):
    drive = SyntheticDrive(7, 3, grid=TINY.voxels.size[:2])
    frames = [make_training_frame(frame, TINY, preprocessing(TINY)) for frame in drive]
    model = initialise(DuoSpaceNet(TINY), seed=0).eval()
    features = [bev_features(model, frame) for frame in frames]
    before, loss = (
        {name: tensor.clone() for name, tensor in model.state_dict().items()},
        loss_of(model, features, frames),
    )
    train_segmentation(model, features, frames, steps=300)
    assert not model.segmentation.training
    assert loss_of(model, features, frames) < 0.8 * loss
    changed = {name for name, tensor in model.state_dict().items() if not torch.equal(tensor, before[name])}
    assert changed
    assert all(name.startswith("segmentation.") for name in changed)


@pytest.mark.parametrize(("step", "factor"), [(0, 0.05), (50, 0.5), (99, 0.00025)])
def test_the_learning_rate_warms_up_and_ends_near_zero(step, factor):
    assert learning_rate_factor(step, 100) == pytest.approx(factor, rel=0.02)
