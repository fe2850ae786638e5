"""The documents: their size, their links, their examples, and every command in them."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from duospacenet.data.results import FrameResultSchema
from duospacenet.data.scene_schema import SceneRecord
from duospacenet.data.scene_writer import write_scene
from duospacenet.model import PRESETS
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.weights import save_checkpoint
from tests.helpers.processes import COMMAND
from tests.helpers.streams import TINY_SIZE_PX

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = sorted((ROOT / "docs").rglob("*.md"))
DOCUMENTS = [README, ROOT / "ARCHITECTURE.md", ROOT / "CONTRIBUTING.md", *PAGES]
TESTED_PAGES = [ROOT / "docs" / f"{name}.md" for name in ("run", "pictures", "scene-folder")]


def blocks(document: Path, language: str) -> list[str]:
    """The fenced code blocks of one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", document.read_text(), re.MULTILINE | re.DOTALL)


def commands(document: Path) -> list[str]:
    """The command lines of a document's shell blocks, without comments."""
    lines = "".join(blocks(document, "sh")).splitlines()
    return [line.split("  #")[0].strip() for line in lines if line and not line.startswith("#")]


def relative_links(document: Path) -> Iterator[str]:
    for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text()):
        if not target.startswith(("http", "#")):
            yield target.split("#")[0]


def prose(document: Path) -> list[str]:
    """The sentences of a document, without code, tables and headings."""
    text = re.sub(r"^```.*?^```", "", document.read_text(), flags=re.MULTILINE | re.DOTALL)
    lines = [line for line in text.splitlines() if not re.match(r"\s*(\||#|!\[)", line)]
    paragraphs = re.split(r"\n\s*(?:\n|- |> )", "\n".join(lines))
    return [part for paragraph in paragraphs for part in re.split(r"(?<=[.:!?])\s+", paragraph) if part.strip()]


@pytest.fixture(scope="module")
def desk(tiny_model, tmp_path_factory) -> Path:
    """A folder with the files that the documents name: a checkpoint and a scene folder of the tiny preset."""
    folder = tmp_path_factory.mktemp("desk")
    save_checkpoint(folder / "model.safetensors", tiny_model)
    grid = PRESETS["tiny"].voxels.size[:2]
    write_scene(folder / "my_rig", SyntheticDrive(seed=7, frames=3, image_size=TINY_SIZE_PX, grid=grid))
    return folder


def run_in(folder: Path, arguments: list[str]) -> None:
    done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, check=False, env=os.environ)
    assert done.returncode == 0, f"{shlex.join(arguments)}\n{done.stderr}"


def run_commands(folder: Path, lines: list[str]) -> None:
    """Run each `duospacenet` command in order. `tiny` takes the place of larger presets."""
    for line in lines:
        program, *arguments = shlex.split(line)
        assert program == "duospacenet", line
        run_in(folder, [*COMMAND, *("tiny" if word == "small" else word for word in arguments)])


def test_the_readme_is_short():
    text = README.read_text()
    assert len(text.splitlines()) <= 150
    assert len(text.split()) <= 1300
    words = sorted(len(sentence.split()) for sentence in prose(README))
    assert words[int(0.9 * len(words))] <= 25


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_has_fewer_than_200_lines(page):
    assert len(page.read_text().splitlines()) < 200


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.stem)
def test_every_link_to_a_file_leads_to_one(document):
    for target in relative_links(document):
        assert (document.parent / target).exists(), target


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.stem)
def test_every_file_that_is_named_exists(document):
    """Paths in backticks such as `runtime/history.py`."""
    folders = (
        "model|runtime|data|synthetic|drawing|rig|evaluation|weights|training|export|jobs|cli|tests|benchmarks|examples"
    )
    for path in re.findall(rf"`((?:{folders})/[\w/.-]+\.\w+)`", document.read_text()):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.stem)
def test_every_make_target_that_is_named_exists(document):
    """Targets in backticks or in a shell block: `make demo`."""
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"(?:`|^)make ([a-z-]+)", document.read_text(), re.MULTILINE)) <= targets


def test_the_commands_of_the_readme_run(desk):
    lines = [line for line in commands(README) if not line.startswith(("pip ", "make "))]
    assert len(lines) >= 4
    run_commands(desk, lines)
    run_python(desk, README)


@pytest.mark.parametrize("page", TESTED_PAGES, ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(page, desk, tiny_bundle, tmp_path):
    shutil.copytree(desk / "my_rig", tmp_path / "my_rig")
    shutil.copytree(tiny_bundle, tmp_path / "bundle")
    lines = commands(page)
    assert len(lines) >= 3
    run_commands(tmp_path, lines)
    run_python(tmp_path, page)


def run_python(folder: Path, document: Path) -> None:
    snippets = blocks(document, "python")
    assert snippets
    for snippet in snippets:
        run_in(folder, [sys.executable, "-c", snippet])


def test_the_example_of_a_scene_is_valid():
    example, *_ = blocks(ROOT / "docs" / "scene-folder.md", "json")
    SceneRecord.model_validate(json.loads(example))


def test_the_example_of_a_result_is_valid():
    [example] = blocks(ROOT / "docs" / "run.md", "json")
    FrameResultSchema.model_validate(json.loads(example))
