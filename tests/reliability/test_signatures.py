"""Signatures of bundles: row A13 of the reliability list. Needs the extra `sign`."""

import random
import shutil
from pathlib import Path

import pytest

from duospacenet.cli.main import run_app
from tests.helpers.signer_keys import Keys, make_keys

pytest.importorskip("model_signing", reason="the extra `sign` is not installed")
pytest.importorskip("OpenSSL", reason="the extra `sign` is not installed")

NUM_OFFSETS = 5  # per file


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Keys:
    return make_keys(tmp_path_factory.mktemp("keys"))


@pytest.fixture
def signed(copied_bundle, keys) -> Path:
    """A bundle that a test may change, with `bundle.sig` beside it."""
    assert run_app(["sign", str(copied_bundle), "--private-key", str(keys.private)]) == 0
    return copied_bundle


def verify(bundle: Path, keys: Keys) -> int:
    return run_app(["verify", str(bundle), "--public-key", str(keys.public)])


def test_a13_an_unchanged_bundle_is_verified_also_under_another_name(signed, keys):
    assert verify(signed, keys) == 0
    renamed = signed.rename(signed.with_name("renamed"))
    signed.with_name("bundle.sig").rename(signed.with_name("renamed.sig"))
    assert verify(renamed, keys) == 0


def test_a13_one_changed_byte_in_any_file_is_found(signed, keys, capfd):
    choose = random.Random(13)
    for path in sorted(path for path in signed.rglob("*") if path.is_file()):
        content = path.read_bytes()
        for offset in [0, len(content) - 1, *(choose.randrange(len(content)) for _ in range(NUM_OFFSETS))]:
            changed = bytearray(content)
            changed[offset] ^= 1 << choose.randrange(8)
            path.write_bytes(changed)
            assert verify(signed, keys) == 4, (path.name, offset)
            assert path.name in capfd.readouterr().err
        path.write_bytes(content)
    assert verify(signed, keys) == 0


@pytest.mark.parametrize(
    "name", ["extra.onnx", ".hidden", ".gitignore", ".git/config", ".github/x", "a/b/c", "bundle.sig"]
)
def test_a13_an_added_file_is_found(signed, keys, capfd, name):
    path = signed / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    assert verify(signed, keys) == 4
    assert name in capfd.readouterr().err


def test_a13_a_removed_or_renamed_file_is_found(signed, keys, capfd):
    (signed / "segmenter.onnx").rename(signed / "renamed.onnx")
    assert verify(signed, keys) == 4
    (signed / "renamed.onnx").unlink()
    assert verify(signed, keys) == 4
    assert "segmenter.onnx" in capfd.readouterr().err


def test_a13_two_exchanged_files_are_found(signed, keys):
    first, second = signed / "lifter.onnx", signed / "decoder.onnx"
    contents = first.read_bytes(), second.read_bytes()
    second.write_bytes(contents[0])
    first.write_bytes(contents[1])
    assert verify(signed, keys) == 4


def test_a13_a_link_to_an_equal_file_is_refused(signed, keys, tmp_path, capfd):
    moved = tmp_path / "lifter.onnx"
    (signed / "lifter.onnx").rename(moved)
    (signed / "lifter.onnx").symlink_to(moved)
    assert verify(signed, keys) == 4
    assert "symbolic link" in capfd.readouterr().err


def test_a13_another_key_is_refused(signed, keys, tmp_path, capfd):
    others = make_keys(tmp_path, "other")
    assert verify(signed, others) == 4
    assert "another private key" in capfd.readouterr().err
    assert run_app(["sign", str(signed), "--private-key", str(others.private), "--overwrite"]) == 0
    assert verify(signed, others) == 0
    assert verify(signed, keys) == 4


def test_a13_the_signature_of_another_bundle_is_refused(signed, keys, tmp_path):
    other = shutil.copytree(signed, tmp_path / "other")
    (other / "README").write_text("more")
    assert run_app(["sign", str(other), "--private-key", str(keys.private)]) == 0
    shutil.copy(tmp_path / "other.sig", signed.with_name("bundle.sig"))
    assert verify(signed, keys) == 4


def test_a13_a_changed_signature_is_refused_without_a_crash(signed, keys, capfd):
    """A changed byte may be outside of what is signed, for example white space in the JSON."""
    path, choose = signed.with_name("bundle.sig"), random.Random(13)
    content = path.read_bytes()
    variants = [content[: len(content) * part // 4] for part in range(4)] + [
        b"{}",
        b"[]",
        b"null",
        b"[" * 9999,
        b"\xff",
    ]
    for _ in range(60):
        changed = bytearray(content)
        changed[choose.randrange(len(content))] = choose.randrange(256)
        variants.append(bytes(changed))
    codes = []
    for variant in variants:
        path.write_bytes(variant)
        codes.append(verify(signed, keys))
        assert "internal error" not in capfd.readouterr().err
    assert set(codes) <= {0, 4}
    assert codes[:9] == [4] * 9
    assert codes.count(4) > 50
    path.unlink()
    assert verify(signed, keys) == 4
