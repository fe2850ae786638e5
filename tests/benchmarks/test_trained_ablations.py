"""Tests of the ablations that continue the training of `nano`."""

import pytest
import torch
from safetensors.torch import load_file

from benchmarks.rendered_clips import RenderedClips
from benchmarks.trained_ablations import CONFIG, inherit, main, train
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.model.presets import ablate
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.training import Settings, Trainer
from duospacenet.training.samples.synthetic_clips import SyntheticClips
from duospacenet.training.samples.training_frames import make_training_frame
from duospacenet.weights.input_contract import preprocessing
from duospacenet.weights.shipped import shipped_weights

TINY = PRESETS["tiny"]
BEV_BRANCH = ("lifter.", "divergence_enhancement.", "segmentation.", "decoder.bev_fusion.")


def changed_tensors(row):
    """The names of the tensors that a row inherits: those that differ from random weights afterwards."""
    model = randomise(DuoSpaceNet(ablate(CONFIG, row) if row else CONFIG), 3)
    before = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    inherit(model, shipped_weights("nano"))
    trained = load_file(shipped_weights("nano"))
    changed = {name for name, tensor in model.state_dict().items() if not torch.equal(tensor, before[name])}
    assert all(torch.equal(model.state_dict()[name], trained[name]) for name in changed)
    return changed


@pytest.fixture(scope="module")
def inherited_by_the_full_model():
    return changed_tensors("")


@pytest.mark.parametrize("row", ["stacking", "attention", "no-fde"])
def test_rows_with_duo_queries_inherit_the_same_tensors_as_the_full_model(row, inherited_by_the_full_model):
    assert changed_tensors(row) == inherited_by_the_full_model


def test_the_full_model_inherits_everything_but_the_bev_branch(inherited_by_the_full_model):
    names = {name for name in DuoSpaceNet(CONFIG).state_dict() if not name.endswith("num_batches_tracked")}
    new = {name for name in names if name.startswith(BEV_BRANCH) or ".cross_attention.bev." in name}
    assert {name for name in inherited_by_the_full_model if not name.endswith("num_batches_tracked")} == names - new


def test_rows_with_one_space_inherit_the_same_tensors():
    inherited = changed_tensors("bev")
    assert changed_tensors("bev-no-fde") == inherited
    assert "queries.pose" in inherited
    assert not any(name.startswith((*BEV_BRANCH, "decoder.layers.")) for name in inherited)


def test_rendered_clips_are_the_training_frames_of_the_drives(tmp_path):
    clips = SyntheticClips(seed=1, num_frames=2, grid=TINY.voxels.size[:2])
    rendered = RenderedClips(tmp_path, clips, num_clips=1, held_out=((7, 1),))
    assert [path.name for path in rendered.missing()] == ["clip-00000.pt", "held-out-7-1.pickle"]
    rendered.render(TINY, workers=1)
    assert not list(rendered.missing())
    frames = [make_training_frame(frame, TINY, preprocessing(TINY)) for frame in clips.frames(0)]
    loaded = rendered.clip(0)
    assert len(loaded) == len(frames) == 2
    for frame, expected in zip(loaded, frames, strict=True):
        assert all(torch.equal(a, b) for a, b in zip(frame, expected, strict=True))
    ((held_out,),) = rendered.held_out_drives
    assert held_out.token == SyntheticDrive(7, 1).frame(0).token
    assert {mask.shape for mask in held_out.ground_truth.maps.values()} == {TINY.voxels.size[:2]}


class NumberedClips:
    """Three equal clips of one frame. It records which ones are read."""

    num_clips = 3

    def __init__(self, frame):
        self.frame = frame
        self.numbers = []

    def clip(self, number):
        self.numbers.append(number)
        return [self.frame]


@pytest.fixture(scope="module")
def tiny_frame():
    drive = SyntheticDrive(7, 1, grid=TINY.voxels.size[:2])
    return make_training_frame(drive.frame(0), TINY, preprocessing(TINY))


def trained_numbers(frame, seed, row=""):
    """The clips that six steps use, in order."""
    model = randomise(DuoSpaceNet(ablate(TINY, row) if row else TINY))
    clips = NumberedClips(frame)
    steps = train(Trainer(model, Settings(steps=6, batch_size=1, seed=seed), torch.device("cpu")), clips)
    assert [step.number for step in steps] == list(range(6))
    return clips.numbers


def test_all_rows_train_on_the_same_clips_in_an_order_that_the_seed_decides(tiny_frame):
    numbers = trained_numbers(tiny_frame, seed=1)
    assert sorted(numbers[:3]) == sorted(numbers[3:]) == [0, 1, 2]
    assert trained_numbers(tiny_frame, seed=1, row="pv") == numbers
    assert any(trained_numbers(tiny_frame, seed=seed) != numbers for seed in (2, 3))


def test_a_row_without_rendered_clips_names_the_missing_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["trained_ablations", str(tmp_path), "--row", "full"])
    with pytest.raises(SystemExit):
        main()
    assert "clip-00000.pt: expected rendered clips; it is missing. Run --render first." in capsys.readouterr().err
