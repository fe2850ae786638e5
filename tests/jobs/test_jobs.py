"""The functions of `duospacenet.jobs`, which are imported on first use."""

import subprocess
import sys
from pathlib import Path

import pytest

from duospacenet import jobs


@pytest.mark.parametrize("name", jobs.__all__)
def test_every_function_of_the_list_exists(name):
    assert getattr(jobs, name).__name__ == name


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'detect'"):
        jobs.detect  # noqa: B018


def test_no_module_has_the_name_of_a_function():
    """The import of such a module would replace the function."""
    modules = {path.stem for path in Path(jobs.__file__).parent.iterdir()}
    assert not modules & set(jobs.__all__)


def test_the_package_itself_imports_no_job():
    code = "import sys, duospacenet.jobs; print(*(name for name in sys.modules if 'duospacenet.jobs' in name))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["duospacenet.jobs"]
