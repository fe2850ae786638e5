"""Exit codes and messages of calls that fail."""

from importlib import import_module

import pytest

from duospacenet.cli.main import run_app
from duospacenet.runtime.process_errors import OtherProcessError


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["exprt"], "No such command 'exprt'. Did you mean 'export'? See `duospacenet --help`."),
        (["export", "--xyz"], "No such option: --xyz. See `duospacenet export --help`."),
        (["config"], "Missing command. See `duospacenet config --help`."),
    ],
)
def test_a_wrong_call_ends_with_2(capsys, arguments, message):
    assert run_app(arguments) == 2
    assert capsys.readouterr().err == f"error: {message}\n"


def test_an_internal_error_ends_with_70_and_no_traceback(monkeypatch, capsys):
    monkeypatch.setattr("duospacenet.jobs.config_file.config_to_toml", lambda _: 1 / 0)
    assert run_app(["config", "show", "tiny"]) == 70
    message = capsys.readouterr().err
    assert message.startswith("internal error: ZeroDivisionError: division by zero\n")
    assert "DUOSPACENET_TRACEBACK=1" in message
    assert "Traceback" not in message


def test_a_developer_can_ask_for_the_traceback(monkeypatch):
    monkeypatch.setattr("duospacenet.jobs.config_file.config_to_toml", lambda _: 1 / 0)
    monkeypatch.setenv("DUOSPACENET_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        run_app(["config", "show", "tiny"])


def test_every_error_class_has_an_exit_code_of_its_own():
    errors = import_module("duospacenet.runtime.errors")
    classes = errors.DuoSpaceNetError.__subclasses__()
    codes = {error.exit_code for error in classes if error.__module__ == errors.__name__}
    assert codes == {1, 2, 3, 4, 5, 6}
    assert (errors.INTERNAL_ERROR_EXIT_CODE, errors.INTERRUPTED_EXIT_CODE) == (70, 130)


@pytest.mark.parametrize(
    ("rank", "code", "message"), [("0", 130, "interrupted\n"), ("1", 130, ""), ("0", 3, ""), ("1", 3, "")]
)
def test_a_process_whose_neighbour_failed_has_its_exit_code_and_reports_an_interruption_once(
    monkeypatch, capfd, rank, code, message
):
    def neighbour_failed(_):
        raise OtherProcessError(code)

    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "test")
    monkeypatch.setenv("RANK", rank)
    monkeypatch.setattr("duospacenet.jobs.config_file.config_to_toml", neighbour_failed)
    assert run_app(["config", "show", "tiny"]) == code
    assert capfd.readouterr().err == message
