"""The browser consumer computes the same boxes as Python, in Node and in Chromium, and finds the usual mistakes."""

import shutil
from pathlib import Path

import pytest

from tests.helpers import browser_consumer
from tests.helpers.browser_fixtures import write_browser_fixtures
from tests.helpers.bundles import edit_manifest
from tests.helpers.consumer_drive import differences, read_lines

TOLERANCE = 1e-4  # m, rad, m/s


@pytest.fixture(scope="module", autouse=True)
def installed() -> None:
    browser_consumer.install()


@pytest.fixture(scope="module")
def fixtures(tiny_bundle, tiny_int8_bundle, tmp_path_factory) -> Path:
    return write_browser_fixtures(tiny_bundle, tiny_int8_bundle, tmp_path_factory.mktemp("browser") / "fixtures")


def test_the_tests_in_node_pass(fixtures):
    browser_consumer.run_tests("test", fixtures)


def test_boxes_in_node_equal_those_of_python_over_a_drive_with_every_event(fixtures, tmp_path):
    out = tmp_path / "results.jsonl"
    done = browser_consumer.call("node", "node/run.js", fixtures / "bundle", fixtures / "drive", "--out", out)
    assert done.returncode == 0, done.stderr
    check_results(out, fixtures / "results.jsonl")


def test_the_page_in_chromium_passes_its_tests_and_has_the_boxes_of_python(fixtures):
    browser_consumer.build()
    browser_consumer.run_tests("test:page", fixtures)
    check_results(fixtures / "page_results.jsonl", fixtures / "results.jsonl")


def check_results(found: Path, expected: Path) -> None:
    lines, python = read_lines(found), read_lines(expected)
    assert differences(lines, python, TOLERANCE) == []
    reasons = [[line["history"]["reset_reason"] for line in results] for results in (lines, python)]
    assert reasons[0] == reasons[1]
    assert len(lines) == 20
    assert sum(len(line["boxes"]) for line in lines) > 1000


def test_commands_end_with_the_exit_codes_of_the_toolkit(fixtures, tiny_bundle, tmp_path):
    damaged = shutil.copytree(tiny_bundle, tmp_path / "damaged")
    (damaged / "lifter.onnx").write_bytes(b"damaged")
    other = edit_manifest(
        shutil.copytree(tiny_bundle, tmp_path / "other"), lambda manifest: manifest["classes"].reverse()
    )
    verify = "node/verify.js"
    for command, code, message in [
        ((verify, tiny_bundle), 0, "verified: 3 frames"),
        ((verify, other), 1, "NOT verified"),
        ((verify,), 2, "Usage: node node/verify.js BUNDLE"),
        ((verify, damaged), 4, "Error: lifter.onnx: expected the SHA-256"),
        (("node/run.js", tiny_bundle, tiny_bundle), 3, "expected a scene folder, with scene.json in it"),
        (("node/run.js", tiny_bundle, fixtures / "drive", "--out", tmp_path / "no" / "out"), 5, "Error: ENOENT"),
    ]:
        done = browser_consumer.call("node", *command)
        assert (done.returncode, message in done.stdout + done.stderr) == (code, True), done.stdout + done.stderr
