"""What the two distributions hold: the toolkit all of its packages and no weights, the other one the weights."""

import tomllib
from pathlib import Path

from duospacenet.weights import shipped

REPOSITORY = Path(__file__).parents[1]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())


def test_every_package_is_part_of_the_wheel():
    setuptools = PROJECT["tool"]["setuptools"]
    folders = {package: REPOSITORY / folder for package, folder in setuptools["package-dir"].items()}
    found = {
        ".".join([package, *init.parent.relative_to(folder).parts])
        for package, folder in folders.items()
        for init in folder.rglob("__init__.py")
    }
    assert sorted(setuptools["packages"]) == sorted(found)


def test_the_wheel_holds_no_weights():
    setuptools = PROJECT["tool"]["setuptools"]
    assert setuptools["include-package-data"] is False
    assert not [
        pattern for patterns in setuptools["package-data"].values() for pattern in patterns if "safetensors" in pattern
    ]


def test_the_wheel_holds_the_files_beside_the_modules_that_the_runtime_reads():
    data = PROJECT["tool"]["setuptools"]["package-data"]
    assert data["duospacenet"] == ["py.typed"]
    assert "web_engine/*" in data["duospacenet.runtime"]
    assert sorted(path.name for path in (REPOSITORY / "runtime" / "web_engine").iterdir()) == [
        "package.json",
        "runner.mjs",
    ]


def test_the_wheel_holds_the_recipes_of_the_training():
    assert PROJECT["tool"]["setuptools"]["package-data"]["duospacenet.training"] == ["recipes/*.toml"]
    assert {path.name for path in (REPOSITORY / "training" / "recipes").iterdir()} == {"cpu.toml", "paper.toml"}


def test_the_distribution_of_the_weights_holds_those_of_the_checkout():
    folder = REPOSITORY / "weights_package"
    project = tomllib.loads((folder / "pyproject.toml").read_text())
    assert project["tool"]["setuptools"]["packages"] == [shipped.PACKAGE]
    packed = sorted((folder / shipped.PACKAGE).glob("*.safetensors"))
    assert [path.stem for path in packed] == sorted(shipped.SHIPPED)
    for path in packed:
        assert path.samefile(REPOSITORY / "weights" / path.name)
