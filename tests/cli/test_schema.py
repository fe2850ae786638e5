import json
from pathlib import Path

import pytest

from duospacenet.cli.main import run_app
from duospacenet.jobs.json_schemas import FILE_FORMATS

FOLDER = Path(__file__).parents[2] / "docs" / "schemas"


@pytest.mark.parametrize("name", FILE_FORMATS)
def test_the_newest_schema_is_printed(name, capfd):
    assert run_app(["schema", name]) == 0
    newest = FILE_FORMATS[name].versions[-1]
    assert capfd.readouterr().out == (FOLDER / f"{name}-{newest}.schema.json").read_text()


def test_an_older_schema_is_printed(capfd):
    assert run_app(["schema", "manifest", "--schema-version", "2"]) == 0
    assert json.loads(capfd.readouterr().out)["$id"] == "urn:duospacenet:schema:manifest:2"


def test_the_help_lists_all_names_and_versions(capfd):
    assert run_app(["schema", "--help"]) == 0
    text = " ".join(capfd.readouterr().out.split())
    assert f"<{'|'.join(FILE_FORMATS)}>" in text
    assert f"manifest has 1 to {FILE_FORMATS['manifest'].versions[-1]}, the others have 1." in text
    assert all(form.versions == (1,) for name, form in FILE_FORMATS.items() if name != "manifest")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["scene", "--schema-version", "2"], "--schema-version: expected 1 for scene; got 2."),
        (
            ["manifest", "--schema-version", "0"],
            "--schema-version: expected 1 to 5 for manifest; got 0.",
        ),
        (["bundle"], "'bundle' is not one of 'manifest', 'results', 'scene', 'expected'"),
        ([], "Missing argument 'NAME'"),
    ],
)
def test_an_unknown_schema_is_refused(arguments, message, capfd):
    assert run_app(["schema", *arguments]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert message in err
