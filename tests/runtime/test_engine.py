import subprocess
import sys

import pytest

from duospacenet.runtime import Pipeline
from duospacenet.runtime.engine import Engine, choose_engine
from duospacenet.runtime.errors import MissingExtraError, UsageError


@pytest.mark.parametrize(
    ("name", "precision", "message"),
    [
        ("tensorrt", "float32", r"--engine: expected onnxruntime, openvino or onnxruntime-web; got 'tensorrt'"),
        ("openvino", "int4", r"--engine-precision: expected float32 or default; got 'int4'"),
        ("\x1b[2J", "float32", r"got '\\x1b\[2J'"),
    ],
)
def test_an_unknown_engine_or_precision_is_refused(name, precision, message):
    with pytest.raises(UsageError, match=message):
        choose_engine(name, precision)


def test_the_default_is_onnxruntime_in_float32(pipeline):
    assert choose_engine() == Engine("onnxruntime", "float32")
    assert pipeline.engine["name"] == "onnxruntime"
    assert pipeline.engine["precision"] == "float32"


def test_an_engine_that_is_not_installed_is_refused_with_the_command_that_installs_it(tiny_bundle, monkeypatch):
    monkeypatch.delitem(sys.modules, "duospacenet.runtime.openvino_session", raising=False)
    monkeypatch.setitem(sys.modules, "openvino", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'duospacenet\[openvino\]'"):
        Pipeline.load(tiny_bundle, engine="openvino")


LOAD = """
import sys
from duospacenet.runtime import Pipeline
Pipeline.load(sys.argv[1], engine=sys.argv[2])
print([name for name in ("openvino", "openvino_telemetry", "openvino_telemetry.main") if name in sys.modules])
"""


@pytest.mark.parametrize(("engine", "imported"), [("onnxruntime", "[]"), ("openvino", "['openvino']")])
def test_openvino_is_only_imported_when_it_is_chosen_and_its_telemetry_never(portable_bundle, engine, imported):
    done = subprocess.run([sys.executable, "-c", LOAD, portable_bundle, engine], capture_output=True, text=True)
    assert done.stdout.strip() == imported, done.stderr
