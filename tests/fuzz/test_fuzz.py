"""Randomly damaged input files are refused with the right error class, or accepted and then work.

Each test runs for FUZZ_SECONDS (two minutes in `make fuzz`, seconds in CI), in rounds of one seed each. Hypothesis
shrinks a failing example and prints its seed. FUZZ_SEED=N repeats it.
"""

import json
import os
import shutil
import time
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, Phase, given, note, seed, settings
from hypothesis import strategies as st
from safetensors.torch import save_file

from duospacenet.data.images import read_image, read_mask
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_writer import write_scene
from duospacenet.model.backbones.resnet import ResNet
from duospacenet.model.config import ResNetConfig
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.bundle_files import check_files
from duospacenet.runtime.bundle.consistency import check_consistency
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.errors import ArtifactError, DuoSpaceNetError, InputError
from duospacenet.runtime.validation import check_frame
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.weights import CheckpointError, load_checkpoint
from tests.fuzz.damage import damaged_bytes, damaged_json, to_text
from tests.helpers.bundles import write_sealed_manifest
from tests.helpers.image_files import HEIGHT, WIDTH, encode, smooth_image, write_file
from tests.helpers.streams import TINY_SIZE_PX, detect_all

SECONDS = float(os.environ.get("FUZZ_SECONDS", "7"))
FIRST_SEED = int(os.environ.get("FUZZ_SEED", "0"))
EXAMPLES_PER_ROUND = 50


def fuzz(strategy: st.SearchStrategy, check: Callable[..., bool]) -> None:
    """Call `check` with examples until the time is over. Some examples must be refused."""
    counts = {True: 0, False: 0}
    deadline_s, number = time.monotonic() + SECONDS, FIRST_SEED
    while time.monotonic() < deadline_s:
        fuzz_round(number, strategy, check, counts, deadline_s)
        number += 1
    print(f"{sum(counts.values())} examples, {counts[False]} refused")
    assert counts[False] > counts[True] / 20


def fuzz_round(
    number: int, strategy: st.SearchStrategy, check: Callable[..., bool], counts: dict[bool, int], deadline_s: float
) -> None:
    """Check the examples of one seed, or as many of them as the time allows."""

    @seed(number)
    @settings(
        max_examples=EXAMPLES_PER_ROUND,
        deadline=None,
        database=None,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def trial(example):
        note(f"FUZZ_SEED={number}")
        if time.monotonic() < deadline_s:
            counts[check(example)] += 1

    trial()


# --- scene.json ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz") / "scene"
    write_scene(folder, SyntheticDrive(3, frames=2, image_size=(40, 16)))
    return folder


def is_accepted(read: Callable[[], object], *errors: type[Exception]) -> bool:
    """Whether `read` returns. It may raise `errors`; any other exception fails the test."""
    try:
        read()
    except errors:
        return False
    return True


def test_a_damaged_scene_is_refused_or_its_frames_are_valid(scene):
    def read():
        for frame in SceneFolder(scene):
            check_frame(frame, num_cameras=len(frame.cameras))
            assert frame.ground_truth is None or np.isfinite(frame.ground_truth.boxes[:, :7]).all()  # velocity: null

    def check(text):
        (scene / "scene.json").write_bytes(text)
        return is_accepted(read, InputError)

    intact = (scene / "scene.json").read_bytes()
    fuzz(st.one_of(damaged_json(json.loads(intact)).map(to_text), damaged_bytes(intact)), check)


# --- manifest.json --------------------------------------------------------------------------------------------------


def test_a_damaged_manifest_is_refused_or_its_bundle_works(tiny_bundle, tmp_path):
    """The hash in the manifest is corrected after the damage, so that the other checks are reached."""
    bundle = shutil.copytree(tiny_bundle, tmp_path / "bundle")
    intact = json.loads((bundle / "manifest.json").read_text())
    del intact["sha256"]
    frames = list(SyntheticDrive(1, frames=2, image_size=TINY_SIZE_PX))

    def read():
        manifest = read_manifest(bundle)
        check_files(bundle, manifest)
        check_consistency(bundle, manifest)
        if any(getattr(manifest, name) != intact[name] for name in ("num_cameras", "precision")):
            return
        for detections in detect_all(Pipeline.load(bundle, require_parity=False), frames, maps=True):
            assert np.isfinite(detections.boxes).all()

    def check(manifest):
        (bundle / "manifest.json").write_bytes(to_text(manifest))
        if isinstance(manifest, dict) and manifest:
            write_sealed_manifest(bundle, manifest)
        return is_accepted(read, DuoSpaceNetError)

    fuzz(damaged_json(intact), check)


def test_a_manifest_of_damaged_bytes_is_refused(tiny_bundle, tmp_path):
    bundle = shutil.copytree(tiny_bundle, tmp_path / "bundle")
    intact = (bundle / "manifest.json").read_bytes()

    def check(data):
        (bundle / "manifest.json").write_bytes(data)
        accepted = is_accepted(lambda: check_files(bundle, read_manifest(bundle)), ArtifactError)
        assert not accepted or data == intact
        return accepted

    fuzz(damaged_bytes(intact), check)


# --- images -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_damaged_image_is_refused_or_has_the_requested_size(tmp_path, suffix):
    def check(data):
        path = write_file(tmp_path, data, "image" + suffix)
        is_accepted(lambda: read_mask(path), InputError)
        try:
            image = read_image(path, WIDTH, HEIGHT)
        except InputError:
            return False
        assert (image.dtype, image.shape) == (np.uint8, (HEIGHT, WIDTH, 3))
        return True

    fuzz(damaged_bytes(encode(smooth_image(), suffix)), check)


# --- checkpoints --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_a_damaged_checkpoint_is_refused_or_loads_finite_numbers(tmp_path, suffix):
    model = ResNet(ResNetConfig("basic", (1, 1, 1, 1), width=2))
    path = tmp_path / f"weights{suffix}"
    if suffix == ".pth":
        torch.save(model.state_dict(), path)
    else:
        save_file(model.state_dict(), path)

    def check(data):
        path.write_bytes(data)
        accepted = is_accepted(lambda: load_checkpoint(path, model), CheckpointError)
        assert all(bool(tensor.isfinite().all()) for tensor in model.state_dict().values())
        return accepted

    fuzz(damaged_bytes(path.read_bytes()), check)
