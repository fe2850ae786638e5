"""A batch on Ray. Ray takes long to start, so one session is used for all of this."""

import json
import os
import shutil
import socket
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from duospacenet import jobs
from duospacenet.jobs.batch.ray_pool import check_ray
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.errors import MissingExtraError, UsageError
from tests.helpers.batch_results import scene_results
from tests.helpers.processes import start
from tests.helpers.scene_files import front_image
from tests.helpers.sockets import Socket, processes_with, sockets_beyond_loopback
from tests.helpers.worker_faults import FAULTS_VARIABLE, WorkerFaults

THREADS = available_cores()  # as the runs that the batch is compared with
TIMEOUT_S = 240


@pytest.mark.skipif(find_spec("ray") is None, reason="needs the extra ray: pip install 'duospacenet[ray]'")
def test_ray_gives_the_same_results_and_a_lost_actor_costs_nothing(
    tiny_bundle, scene_folders, run_of_each_scene, tmp_path
):
    """`city` kills its actor once, `tunnel` each time, and `bridge` has a broken image."""
    (tmp_path / "home").mkdir()
    (tmp_path / "sources").mkdir()
    sources = {scene.name: Path(shutil.copytree(scene, tmp_path / "sources" / scene.name)) for scene in scene_folders}
    image = front_image(sources["bridge"], 3)
    image.write_bytes(image.read_bytes()[:-40])
    out = tmp_path / "out"
    faults = WorkerFaults(tmp_path / "faults", out)
    faults.kill(sources["city"], 3, once=True)
    faults.kill(sources["tunnel"], 3, once=False)
    environment = faults.environment()
    arguments = ["batch", tiny_bundle, *sources.values(), "--out", out, "--ray", "local", "--workers", 2]
    arguments += ["--threads", THREADS, "--maps", "--json"]
    process = start(arguments, env=os.environ | environment | {"HOME": str(tmp_path / "home")})
    reached = watch_sockets(process, environment[FAULTS_VARIABLE])
    stdout, stderr = process.communicate(timeout=TIMEOUT_S)

    assert process.returncode == 1, stderr
    summary = json.loads(stdout)
    outcomes = {outcome["scene"]: outcome for outcome in summary["outcomes"]}
    assert {name: outcome["status"] for name, outcome in outcomes.items()} == {
        "city": "done", "bridge": "failed", "tunnel": "failed", "park": "done"
    }  # fmt: skip
    assert outcomes["city"]["tries"] == 2
    assert "its worker process ended in each of 3 tries" in outcomes["tunnel"]["cause"]
    assert "CAM_FRONT/000003.png" in outcomes["bridge"]["cause"]
    assert scene_results(out) == {name: run_of_each_scene[name] for name in ("city", "park")}
    assert len({outcome["worker"] for outcome in outcomes.values()}) >= 2
    # No other machine was reached or could reach Ray, and nothing is left.
    assert reached == set()
    assert faults.hosts() <= {"127.0.0.1", "localhost"}
    assert processes_with(FAULTS_VARIABLE, environment[FAULTS_VARIABLE]) == []
    assert list((tmp_path / "home").iterdir()) == []

    # A batch of Ray is continued by local workers.
    shutil.copy(front_image(scene_folders[1], 3), image)
    jobs.run_batch(tiny_bundle, list(sources.values()), out, maps=True, threads=THREADS, resume=True)
    assert scene_results(out) == run_of_each_scene


def watch_sockets(process, faults: str) -> set[Socket]:
    """The sockets beyond loopback of a batch and all of its processes, until it ends."""
    found: set[Socket] = set()
    start_s = time.monotonic()
    while process.poll() is None and time.monotonic() - start_s < TIMEOUT_S:
        found |= sockets_beyond_loopback(processes_with(FAULTS_VARIABLE, faults))
        time.sleep(0.2)
    return found


def test_addresses_are_local_auto_and_those_of_listening_hosts(monkeypatch):
    monkeypatch.setattr("duospacenet.jobs.batch.ray_pool.find_spec", lambda name: name)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        for address in ("local", "auto", f"127.0.0.1:{port}", f"localhost:{port}"):
            check_ray(address)
    with pytest.raises(UsageError, match=f"--ray: expected a Ray cluster at 127.0.0.1:{port}; it cannot be reached"):
        check_ray(f"127.0.0.1:{port}")
    with pytest.raises(UsageError, match="it cannot be reached"):
        check_ray("127.0.0.1:99999")


@pytest.mark.parametrize("address", ["", "head", ":6379", "head:", "head:port", "ray://head:10001", "http://head:8265"])
def test_other_addresses_are_refused(address, monkeypatch):
    monkeypatch.setattr("duospacenet.jobs.batch.ray_pool.find_spec", lambda name: name)
    with pytest.raises(UsageError, match="--ray: expected local, auto or HOST:PORT"):
        check_ray(address)


@pytest.mark.parametrize("missing", ["ray", "pyarrow"])
def test_a_part_of_the_extra_that_is_missing_is_named(missing, monkeypatch):
    monkeypatch.setattr("duospacenet.jobs.batch.ray_pool.find_spec", lambda name: None if name == missing else name)
    with pytest.raises(MissingExtraError, match=f"expected the package {missing} from the extra 'ray'"):
        check_ray("local")
