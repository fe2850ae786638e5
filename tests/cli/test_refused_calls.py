"""Calls of the command line that end with an error: the exit code, the message, and that nothing is written."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.weights import save_checkpoint
from tests.helpers.scene_files import copy_tree, edit_scene, front_image, set_focal_length

DRIVE = "synthetic:5:3"

REFUSED_CALLS = {
    "no such command": (["fly"], 2, "No such command"),
    "unknown option": (["inspect", "{bundle}", "--fast"], 2, "No such option"),
    "unknown preset": (["export", "--preset", "huge", "--random-weights", "--out", "{out}"], 2, "one of tiny, "),
    "no weights": (
        ["export", "--preset", "tiny", "--out", "{out}"],
        2,
        "expected either --weights FILE or --random-weights; got neither",
    ),
    "both weights": (
        ["export", "--preset", "tiny", "--random-weights", "--weights", "{checkpoint}", "--out", "{out}"],
        2,
        "expected either --weights FILE or --random-weights; got both",
    ),
    "unknown format": (["run", "{bundle}", DRIVE, "--out", "{out}", "--format", "xml"], 2, "expected jsonl or"),
    "missing checkpoint": (
        ["export", "--preset", "tiny", "--weights", "{tmp}/none.safetensors", "--out", "{out}"],
        4,
        "expected a checkpoint, .safetensors or .pth; got no such file",
    ),
    "truncated checkpoint": (
        ["export", "--preset", "tiny", "--weights", "{tmp}/cut.safetensors", "--out", "{out}"],
        4,
        "the file is truncated",
    ),
    "another preset's checkpoint": (
        ["export", "--preset", "nano", "--weights", "{checkpoint}", "--out", "{out}"],
        4,
        "mis-shaped",
    ),
    "missing bundle": (["run", "{tmp}/none", DRIVE, "--out", "{out}"], 4, "expected a bundle folder"),
    "tampered graph": (
        ["run", "{tmp}/tampered", DRIVE, "--out", "{out}"],
        4,
        "decoder.onnx: field graphs.decoder.sha",
    ),
    "missing scene": (["run", "{bundle}", "{tmp}/none", "--out", "{out}"], 3, "none"),
    "bad drive": (["run", "{bundle}", "synthetic:x", "--out", "{out}"], 3, "synthetic:x"),
    "unreadable image": (["run", "{bundle}", "{tmp}/garbled", "--out", "{out}"], 3, "CAM_FRONT"),
    "wrong size": (["run", "{bundle}", "{tmp}/resized", "--out", "{out}"], 3, "CAM_FRONT"),
    "NaN in a matrix": (["run", "{bundle}", "{tmp}/nan", "--out", "{out}"], 3, "intrinsics_px"),
    "unknown camera": (["run", "{bundle}", "{tmp}/unknown", "--out", "{out}"], 3, "CAM_ROOF"),
    "older time stamp": (["run", "{bundle}", "{tmp}/older", "--out", "{out}"], 3, "timestamp_s"),
    "existing bundle": (
        ["export", "--preset", "tiny", "--random-weights", "--out", "{bundle}"],
        5,
        "it exists already",
    ),
    "unwritable out": (["run", "{bundle}", DRIVE, "--out", "/proc/none/out"], 5, "cannot be written"),
}


@pytest.fixture(scope="module")
def inputs(tiny_bundle, tiny_model, tmp_path_factory) -> dict[str, Path]:
    """Valid and invalid inputs, by the names that REFUSED_CALLS uses."""
    tmp = tmp_path_factory.mktemp("inputs")
    save_checkpoint(tmp / "tiny.safetensors", tiny_model)
    (tmp / "cut.safetensors").write_bytes((tmp / "tiny.safetensors").read_bytes()[:5000])
    copy_tree(tiny_bundle, tmp / "tampered")
    decoder = bytearray((tmp / "tampered" / "decoder.onnx").read_bytes())
    decoder[len(decoder) // 2] ^= 1
    (tmp / "tampered" / "decoder.onnx").write_bytes(decoder)
    write_scene(tmp / "valid", SyntheticDrive.parse(DRIVE))
    for name in ("garbled", "resized", "nan", "unknown", "older"):
        copy_tree(tmp / "valid", tmp / name)
    front = front_image(tmp / "garbled")
    front.write_bytes(front.read_bytes()[:200])
    cv2.imwrite(str(front_image(tmp / "resized")), np.zeros((10, 10, 3), np.uint8))
    edit_scene(tmp / "nan", lambda scene: set_focal_length(scene, float("nan")))
    edit_scene(tmp / "unknown", lambda scene: scene["frames"][0]["cameras"].update(CAM_ROOF={"image": None}))
    edit_scene(tmp / "older", lambda scene: scene["frames"][1].update(timestamp_s=scene["frames"][0]["timestamp_s"]))
    return {"tmp": tmp, "bundle": tiny_bundle, "checkpoint": tmp / "tiny.safetensors"}


@pytest.mark.parametrize("call", REFUSED_CALLS)
def test_a_refused_call_ends_with_its_exit_code_and_a_message(inputs, call, tmp_path, capfd):
    arguments, code, words = REFUSED_CALLS[call]
    assert run_app([argument.format(**inputs, out=tmp_path / "out") for argument in arguments]) == code
    printed = capfd.readouterr()
    assert words in printed.err
    assert "Traceback" not in printed.err
    assert "internal error" not in printed.err
    assert printed.out == ""
    assert not (tmp_path / "out" / "manifest.json").exists()


def test_a_missing_extra_is_named(tiny_bundle, tmp_path):
    """In a process that cannot import torch."""
    missing = ("torch", "onnx", "onnx_ir", "onnxscript", "safetensors")
    block = f"import sys; sys.modules.update(dict.fromkeys({missing})); from duospacenet.cli.main import main; main()"
    call = [sys.executable, "-c", block, "export", "--preset", "tiny", "--random-weights", "--out", str(tmp_path / "b")]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 6
    assert "pip install 'duospacenet[export]'" in done.stderr
    run = [sys.executable, "-c", block, "run", str(tiny_bundle), DRIVE, "--out", str(tmp_path / "o"), "--draw"]
    assert subprocess.run(run, capture_output=True, text=True, check=False).returncode == 0
