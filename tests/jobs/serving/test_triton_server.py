"""A real Triton with a model repository: its sequences, what it refuses, and results equal to those in this process."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from duospacenet.data.scene_folder import SceneFolder
from duospacenet.jobs import package_triton
from duospacenet.jobs.serving.serving_options import ServingOptions
from tests.helpers.consumer_drive import write_consumer_drive
from tests.helpers.pytriton import RunningServer, run_client, running_triton

IDLE_S = 5.0


@pytest.fixture(scope="module")
def repository(tiny_bundle, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("triton") / "models"
    package_triton(tiny_bundle, out, ServingOptions(vehicles=2, idle_s=IDLE_S))
    return out


@pytest.fixture(scope="module")
def server(repository) -> Iterator[RunningServer]:
    with running_triton(repository, repository.parent / "server.log") as started:
        yield started


@pytest.mark.slow
def test_sequences_on_a_real_server_are_kept_apart_and_equal_a_stream_in_this_process(
    server, repository, tiny_bundle, tmp_path, pipeline
):
    scene = write_consumer_drive(tiny_bundle, tmp_path / "scene")
    arguments = ["--url", server.url, "--scene", scene, "--free", "--save", tmp_path / "alone.npz"]
    done = run_client(repository / "check_sequences.py", arguments)
    assert done.returncode == 0, done.stdout + done.stderr + server.log.read_text(errors="replace")[-2000:]
    assert done.stdout.count("passed  ") == 7
    golden = run_client(repository / "check_sequences.py", ["--url", server.url])
    assert golden.returncode == 0, golden.stdout + golden.stderr
    assert "passed  The boxes are those of the bundle's golden example" in golden.stdout
    stream, saved = pipeline.stream(maps=True), np.load(tmp_path / "alone.npz")
    for index, frame in enumerate(SceneFolder(scene)):
        detections = stream.step(frame)
        masks = list(detections.maps.values())
        expected = {"boxes": detections.boxes, "scores": detections.scores, "maps": np.array(masks, np.float32)}
        for name, array in expected.items():
            assert saved[f"{index}.{name}"].tobytes() == array.tobytes(), (index, name)
        assert saved[f"{index}.attributes"].tolist() == [name.encode() for name in detections.attributes]
        assert saved[f"{index}.history_frames"].tolist() == [detections.history.frames]
        assert saved[f"{index}.reset_reason"].tolist() == [(detections.history.reset_reason or "").encode()]
        assert saved[f"{index}.skipped"].tolist() == [(detections.skipped or "").encode()]
