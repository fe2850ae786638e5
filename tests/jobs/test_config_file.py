"""Configuration files: what `config show` prints is read back; mistakes are refused with the file and the field."""

from dataclasses import replace

import pytest

from duospacenet.jobs.config_file import MAX_CONFIG_BYTES, config_to_json, config_to_toml, read_config_file
from duospacenet.model import PRESETS
from duospacenet.runtime.errors import InputError

TINY = PRESETS["tiny"]


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(("name", "to_text"), [("mine.toml", config_to_toml), ("mine.json", config_to_json)])
def test_a_written_configuration_is_read_back(tmp_path, preset, name, to_text):
    (tmp_path / name).write_text(to_text(PRESETS[preset]))
    assert read_config_file(tmp_path / name) == PRESETS[preset]


def test_names_with_quotes_and_other_scripts_are_read_back(tmp_path):
    config = replace(TINY, preset='mine "one" \\ 写真', classes=("car", "Straßenbahn 🚋", "a'b"))
    (tmp_path / "mine.toml").write_text(config_to_toml(config), encoding="utf-8")
    assert read_config_file(tmp_path / "mine.toml") == config


def test_an_edited_field_changes_the_configuration(tmp_path):
    text = config_to_toml(TINY).replace("num_queries = 32", "num_queries = 24").replace('"tiny"', '"mine"')
    (tmp_path / "mine.toml").write_text(text)
    assert read_config_file(tmp_path / "mine.toml") == replace(TINY, num_queries=24, preset="mine")


def test_fields_with_a_default_may_be_left_out(tmp_path):
    (tmp_path / "mine.toml").write_text(
        'preset = "mine"\n[image]\nwidth_px = 160\nheight_px = 64\n'
        '[backbone]\nblock = "basic"\ndepths = [1, 1, 1, 1]\n[voxels]\nsize = [16, 16, 4]\n'
    )
    assert read_config_file(tmp_path / "mine.toml").num_queries == 900


MISTAKES = {
    "an unknown field": ("num_queries", "num_querys", "field num_querys is unknown; expected only preset, image, "),
    "an unknown field of a table": (
        "width_px",
        "breadth_px = 3\nwidth_px",
        "field image.breadth_px is unknown; ",
    ),
    "a wrong value": ('"rgb"', '"rbg"', "field image.colour_order: Input should be 'rgb' or 'bgr'; got 'rbg'"),
    "a string for a number": ("num_queries = 32", 'num_queries = "32"', "field num_queries: Input should be a valid "),
    "values that do not fit": ("channels = 32", "channels = 30", "field channels: expected a multiple of num_heads"),
    "infinity": ("123.675", "inf", "field image.mean.0: Input should be a finite number; got inf"),
    "a date": ("num_queries = 32", "num_queries = 2020-01-02", "field num_queries: Input should be a valid integer"),
    "broken TOML": ("num_queries = 32", "num_queries = ", "expected TOML; it cannot be parsed ("),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_refused_with_the_file_and_the_field(tmp_path, mistake):
    right, wrong, message = MISTAKES[mistake]
    text = config_to_toml(TINY)
    assert right in text
    (tmp_path / "mine.toml").write_text(text.replace(right, wrong, 1))
    with pytest.raises(InputError) as error:
        read_config_file(tmp_path / "mine.toml")
    assert str(error.value).startswith(f"{tmp_path / 'mine.toml'}: {message}")


BROKEN_FILES = {
    "mine.yaml": (b"preset: mine", "expected a file name that ends in .toml or .json"),
    "list.json": (b"[1, 2]", "expected a JSON object; got \\[1, 2\\]"),
    "broken.json": (b'{"preset": ', "expected JSON; got 11 characters that are not"),
    "deep.json": (b"[" * 100_000, "expected JSON; got arrays or objects that are nested too deeply"),
    "latin.toml": (b'preset = "\xe9"', "expected TOML; it cannot be parsed"),
    "large.toml": (b"#" * (MAX_CONFIG_BYTES + 1), "expected a configuration of at most 1000000 bytes"),
}


@pytest.mark.parametrize("name", BROKEN_FILES)
def test_a_file_of_another_kind_is_refused(tmp_path, name):
    content, message = BROKEN_FILES[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_config_file(tmp_path / name)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"mine\.toml: expected a configuration file; .*No such file"):
        read_config_file(tmp_path / "mine.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(InputError, match="Is a directory"):
        read_config_file(tmp_path / "folder.toml")
