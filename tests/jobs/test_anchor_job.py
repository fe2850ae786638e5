"""The clustering of anchors as a function: it writes the same file as the command, and prints nothing."""

import json

from duospacenet.cli.main import run_app
from duospacenet.jobs import cluster_anchors


def test_the_job_writes_the_same_file_as_the_command(tmp_path, capfd):
    messages = []
    summary = cluster_anchors("synthetic:5:2", 8, tmp_path / "job.json", seed=3, notify=messages.append)
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""
    assert messages == [f"clustering {summary.num_boxes} boxes ..."]
    command = ["anchors", "synthetic:5:2", "--queries", "8", "--seed", "3", "--out", str(tmp_path / "command.json")]
    assert run_app([*command, "--json"]) == 0
    assert (tmp_path / "job.json").read_bytes() == (tmp_path / "command.json").read_bytes()
    expected = json.loads(capfd.readouterr().out) | {"anchors": str(tmp_path / "job.json")}
    assert summary.to_dict() == expected
