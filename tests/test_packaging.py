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
    assert setuptools["package-data"] == {"duospacenet": ["py.typed"]}


def test_the_distribution_of_the_weights_holds_those_of_the_checkout():
    folder = REPOSITORY / "weights_package"
    project = tomllib.loads((folder / "pyproject.toml").read_text())
    assert project["tool"]["setuptools"]["packages"] == [shipped.PACKAGE]
    packed = sorted((folder / shipped.PACKAGE).glob("*.safetensors"))
    assert [path.stem for path in packed] == sorted(shipped.SHIPPED)
    for path in packed:
        assert path.samefile(REPOSITORY / "weights" / path.name)
