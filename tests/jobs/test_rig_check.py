"""The check of a rig as a function: it writes the same files as the command, and prints nothing."""

import numpy as np

from duospacenet.cli.main import run_app
from duospacenet.jobs import check_rig
from tests.helpers.output_files import contents
from tests.helpers.rigs import change_extrinsics, write_rig


def test_the_job_writes_the_same_files_as_the_command(tmp_path, capfd):
    rig = write_rig(tmp_path / "rig", change_extrinsics("FRONT", np.linalg.inv))
    check = check_rig(rig, tmp_path / "job")
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""
    assert check.broken == ["camera FRONT"]
    assert run_app(["check-rig", str(rig), "--out", str(tmp_path / "command")]) == 1
    assert contents(tmp_path / "job") == contents(tmp_path / "command")
