"""The C++ consumer runs the golden example of a bundle, and the example finds faults of the consumer."""

import shutil
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.helpers import cpp_consumer


class Fault(NamedTuple):
    """A line of the consumer's source, the same line with a fault, and the tensor that must differ first."""

    source: str
    line: str
    faulty_line: str
    tensor: str


FAULTS = {
    "RGB instead of BGR": Fault(
        "preprocessing.cpp",
        ".copyTo(input);",
        ".copyTo(input); cv::cvtColor(input, input, cv::COLOR_BGR2RGB);",
        "inputs.images",
    ),
    "x and y swapped in the projections": Fault(
        "preprocessing.cpp",
        "const cv::Matx34d projection = image_T_ego_of(camera, resize);",
        "const cv::Matx34d projection = cv::Matx33d(0, 1, 0, 1, 0, 0, 0, 0, 1) * image_T_ego_of(camera, resize);",
        "projector.",
    ),
    "transposed ego motion": Fault(
        "history.cpp",
        "set_transform(past_T_now, slot, inverse(frame.global_T_ego) * now.global_T_ego);",
        "set_transform(past_T_now, slot, (inverse(frame.global_T_ego) * now.global_T_ego).t());",
        "inputs.past_T_now",
    ),
    "cached values of the oldest frame in slot 1": Fault(
        "history.cpp",
        "values.emplace(slot_name, past_[slot - 1].memory.at(name));",
        "values.emplace(slot_name, past_[past_.size() - slot].memory.at(name));",
        "decoder.",
    ),
}


@pytest.fixture(scope="module", autouse=True)
def built() -> None:
    cpp_consumer.build()


def test_the_golden_example_agrees(portable_bundle):
    done = cpp_consumer.call(portable_bundle, "--verify", "--threads", 1)
    assert done.returncode == 0, done.stderr
    assert "values agree" in done.stderr


@pytest.mark.parametrize("name", FAULTS)
def test_the_golden_example_finds_a_fault_of_the_consumer(name, portable_bundle, tmp_path):
    fault = FAULTS[name]
    program = cpp_consumer.build_with_fault(tmp_path, fault.source, fault.line, fault.faulty_line)
    done = cpp_consumer.call(portable_bundle, "--verify", "--threads", 1, program=program)
    assert done.returncode == 1, done.stderr
    assert fault.tensor in done.stderr
    assert "expected" in done.stderr
    assert "found" in done.stderr


@pytest.mark.parametrize("part", ["expected.json", "results.jsonl", "scene/scene.json"])
def test_a_damaged_golden_example_is_a_bad_bundle(part, copied_portable_bundle):
    path: Path = copied_portable_bundle / "golden" / part
    path.write_bytes(path.read_bytes() + b"\n")
    done = cpp_consumer.call(copied_portable_bundle, "--verify", "--threads", 1)
    assert done.returncode == 4
    assert part in done.stderr


def test_a_bundle_runs_without_its_golden_example_but_cannot_be_verified(copied_portable_bundle, tmp_path):
    shutil.rmtree(copied_portable_bundle / "golden")
    done = cpp_consumer.call(copied_portable_bundle, "--verify", "--threads", 1)
    assert done.returncode == 4
    assert "golden" in done.stderr
