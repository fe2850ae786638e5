"""`duospacenet sign` and `duospacenet verify`: output, exit codes, the network, and the missing extra."""

import json
import os
import subprocess
import sys

import pytest

from duospacenet.cli.main import run_app
from tests.helpers.processes import COMMAND
from tests.helpers.signer_keys import make_keys
from tests.helpers.system_calls import can_trace, trace_internet

WITHOUT_PACKAGE = """
import sys
from importlib.abc import MetaPathFinder

class Blocker(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == sys.argv[1]:
            raise ImportError(f"{name} is not installed", name=name)

sys.meta_path.insert(0, Blocker())
from duospacenet.cli.main import run_app
sys.exit(run_app(sys.argv[2:]))
"""


@pytest.mark.parametrize("package", ["model_signing", "cryptography"])
def test_without_the_extra_the_command_that_installs_it_is_printed(tiny_bundle, tmp_path, package):
    for name, key in (("sign", "--private-key"), ("verify", "--public-key")):
        arguments = [name, str(tiny_bundle), key, str(tmp_path / "key")]
        command = [sys.executable, "-c", WITHOUT_PACKAGE, package, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 6
        assert "pip install 'duospacenet[sign]'" in done.stderr


def test_both_commands_print_the_files_and_the_key(copied_bundle, tmp_path, capfd):
    pytest.importorskip("model_signing", reason="the extra `sign` is not installed")
    keys = make_keys(tmp_path)
    sign = ["sign", str(copied_bundle), "--private-key", str(keys.private), "--signature", str(tmp_path / "a b.sig")]
    verify = ["verify", str(copied_bundle), "--public-key", str(keys.public), "--signature", str(tmp_path / "a b.sig")]
    assert run_app([*sign, "--json"]) == 0
    signed = json.loads(capfd.readouterr().out)
    files = [path.relative_to(copied_bundle).as_posix() for path in copied_bundle.rglob("*") if path.is_file()]
    assert signed["files"] == sorted(files)
    assert run_app([*verify, "--json"]) == 0
    assert json.loads(capfd.readouterr().out) == signed
    assert run_app(verify) == 0
    printed = capfd.readouterr()
    assert f"all {len(signed['files'])} files" in printed.out
    assert signed["key_sha256"] in printed.out
    assert printed.err == ""
    assert run_app(sign) == 5
    assert "--overwrite" in capfd.readouterr().err
    (copied_bundle / "extra").touch()
    assert run_app([*verify, "--json"]) == 4
    printed = capfd.readouterr()
    assert printed.out == ""
    assert "extra" in printed.err


@pytest.mark.skipif(not can_trace(), reason="strace is not installed or not allowed")
def test_a_password_comes_from_the_environment_and_no_connection_is_opened(copied_bundle, tmp_path):
    pytest.importorskip("model_signing", reason="the extra `sign` is not installed")
    keys, home, log = make_keys(tmp_path, password="secret"), tmp_path / "home", tmp_path / "trace"
    home.mkdir()
    variables = {"HOME": str(home), "DUOSPACENET_KEY_PASSWORD": "secret", "PYTHONDONTWRITEBYTECODE": "1"}
    for name, key in (("sign", ["--private-key", keys.private]), ("verify", ["--public-key", keys.public])):
        command = trace_internet([*COMMAND, name, str(copied_bundle), *map(str, key)], log)
        done = subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "AF_INET" not in log.read_text()
        assert not list(home.iterdir())
