"""The alternatives by the names that `--against` takes."""

from pathlib import Path

import pytest

from duospacenet.jobs.benchmarking import targets
from duospacenet.jobs.benchmarking.targets import Target, describe_target, parse_alternatives
from duospacenet.runtime.errors import ArtifactError, MissingExtraError, UsageError
from tests.helpers.scene_files import copy_tree


@pytest.fixture
def target(tiny_bundle) -> Target:
    return Target(name="bundle", kind="bundle", bundle=tiny_bundle, threads=2)


def test_peers_have_the_model_of_the_bundle(target):
    found = parse_alternatives(["eager,stateless", "compile"], target)
    assert [(each.name, each.kind, each.bundle, each.threads) for each in found] == [
        (name, name, target.bundle, 2) for name in ("eager", "stateless", "compile")
    ]


def test_a_folder_is_a_bundle_on_the_engine_of_the_measured_one(target, tiny_bundle):
    (found,) = parse_alternatives([str(tiny_bundle)], target)
    assert (found.kind, found.bundle, found.engine) == ("bundle", tiny_bundle, "onnxruntime")


def test_an_engine_can_be_named_with_a_folder(target, tiny_bundle):
    pytest.importorskip("openvino")
    (found,) = parse_alternatives([f"openvino:{tiny_bundle}"], target)
    assert (found.kind, found.bundle, found.engine) == ("bundle", tiny_bundle, "openvino")


def test_a_folder_may_have_a_comma_in_its_name(target, tiny_bundle, tmp_path):
    copy_tree(tiny_bundle, tmp_path / "a,b")
    (found,) = parse_alternatives([str(tmp_path / "a,b")], target)
    assert found.bundle == tmp_path / "a,b"


@pytest.mark.parametrize("name", ["tensorrt", "", "eagr", "none/bundle", "tensorrt:out"])
def test_an_unknown_name_is_refused(target, name):
    with pytest.raises(UsageError, match="--against: expected eager, compile, stateless, openvino, or the folder of"):
        parse_alternatives([f"eager,{name}"], target)


def test_a_name_that_is_given_twice_is_refused(target):
    with pytest.raises(UsageError, match="expected each alternative once; got 'eager' twice"):
        parse_alternatives(["eager,stateless", "eager"], target)


def test_a_folder_that_is_not_a_bundle_is_refused(target, tmp_path):
    with pytest.raises(ArtifactError, match=r"manifest\.json"):
        parse_alternatives([str(tmp_path)], target)


@pytest.mark.parametrize("peer, package, extra", [("eager", "torch", "export"), ("openvino", "openvino", "openvino")])
def test_a_peer_without_its_library_names_the_extra(target, monkeypatch, peer, package, extra):
    find_spec = targets.find_spec
    monkeypatch.setattr(targets, "find_spec", lambda name: None if name == package else find_spec(name))
    with pytest.raises(MissingExtraError, match=rf"package {package} from the extra '{extra}'"):
        parse_alternatives([peer], target)


def test_descriptions_name_precision_weights_and_engine(target):
    assert describe_target(target) == "tiny, float32, weights of unknown origin; onnxruntime"
    eager = target.model_copy(update={"kind": "eager", "weights": Path("a/nano\x1b.safetensors")})
    assert describe_target(eager) == "PyTorch, stateless over the window; nano\\x1b.safetensors"
