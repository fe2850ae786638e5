"""`duospacenet package triton`: output, exit codes and help."""

import json

from duospacenet.cli.main import run_app


def test_the_command_writes_a_repository_and_says_so(tiny_bundle, tmp_path, capfd):
    out = tmp_path / "two models"
    arguments = ["package", "triton", str(tiny_bundle), str(out), "--vehicles", "2", "--idle-seconds", "5"]
    assert run_app(arguments) == 0
    printed = capfd.readouterr()
    assert (printed.out, printed.err.split(":")[0]) == ("", f"wrote {out}")
    assert "model duospacenet for 2 vehicles" in printed.err
    assert "max_sequence_idle_microseconds: 5000000" in (out / "duospacenet/config.pbtxt").read_text()
    assert run_app(arguments) == 5
    assert "--overwrite" in capfd.readouterr().err
    assert run_app([*arguments, "--overwrite", "--json"]) == 0
    written = json.loads(capfd.readouterr().out)
    assert (written["out"], written["vehicles"], written["idle_s"]) == (str(out), 2, 5.0)


def test_each_kind_of_error_has_its_exit_code(tiny_bundle, copied_bundle, tmp_path, capfd):
    out = str(tmp_path / "models")
    (copied_bundle / "decoder.onnx").unlink()
    calls = {
        2: ["package", "triton", str(tiny_bundle), out, "--idle-seconds", "1"],
        4: ["package", "triton", str(copied_bundle), out],
        5: ["package", "triton", str(tiny_bundle), "/proc/models"],
    }
    for code, arguments in calls.items():
        assert run_app(arguments) == code
        assert "Traceback" not in capfd.readouterr().err
    assert not (tmp_path / "models").exists()


def test_the_help_has_an_example_and_fits_80_columns(monkeypatch, capfd):
    monkeypatch.setenv("COLUMNS", "80")
    assert run_app(["package", "triton", "--help"]) == 0
    printed = capfd.readouterr().out
    assert "\n    duospacenet package triton " in printed
    assert max(map(len, printed.splitlines())) <= 80
