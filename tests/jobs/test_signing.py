"""Signing and verifying a bundle: keys, places of the signature, and other implementations. Needs the extra `sign`."""

import base64
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from duospacenet.jobs.signing import sign_bundle, verify_bundle
from duospacenet.runtime.errors import ArtifactError, InputError, OutputError, UsageError
from tests.helpers.output_files import contents
from tests.helpers.processes import COMMAND
from tests.helpers.signer_keys import Keys, make_keys

pytest.importorskip("model_signing", reason="the extra `sign` is not installed")
pytest.importorskip("OpenSSL", reason="the extra `sign` is not installed")


@pytest.fixture(scope="module")
def keys(tmp_path_factory) -> Keys:
    return make_keys(tmp_path_factory.mktemp("keys"))


@pytest.mark.parametrize("curve", ["P-256", "P-384", "P-521"])
def test_a_signature_covers_every_file_and_changes_none(copied_bundle, tmp_path, curve):
    before = contents(copied_bundle)
    keys = make_keys(tmp_path, curve=curve)
    signed = sign_bundle(copied_bundle, keys.private)
    assert signed.signature == tmp_path / "bundle.sig"
    assert list(signed.files) == sorted(before)
    assert verify_bundle(copied_bundle, keys.public) == signed
    assert contents(copied_bundle) == before


def test_the_hash_of_the_key_is_that_of_its_file(copied_bundle, keys):
    expected = subprocess.run(["sha256sum", keys.public], capture_output=True, text=True, check=True).stdout.split()[0]
    assert sign_bundle(copied_bundle, keys.private).key_sha256 == expected


def test_files_of_git_are_signed_too(copied_bundle, keys):
    (copied_bundle / ".gitattributes").write_text("*.onnx binary\n")
    assert ".gitattributes" in sign_bundle(copied_bundle, keys.private).files
    verify_bundle(copied_bundle, keys.public)
    (copied_bundle / ".gitattributes").write_text("*.onnx text\n")
    with pytest.raises(ArtifactError, match=r"changed: \.gitattributes"):
        verify_bundle(copied_bundle, keys.public)


def test_an_encrypted_key_needs_its_password(copied_bundle, tmp_path):
    keys = make_keys(tmp_path, password="secret")
    with pytest.raises(InputError, match="expected the password of this encrypted key"):
        sign_bundle(copied_bundle, keys.private)
    with pytest.raises(InputError, match="cannot be decrypted"):
        sign_bundle(copied_bundle, keys.private, password="other")
    sign_bundle(copied_bundle, keys.private, password="secret")
    verify_bundle(copied_bundle, keys.public)


# --- other implementations ----------------------------------------------------------------------------------------


def call_model_signing(*arguments: object) -> int:
    command = [sys.executable, "-m", "model_signing", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, check=False).returncode


def test_model_signing_verifies_a_signature_of_this_toolkit(copied_bundle, keys):
    signature = sign_bundle(copied_bundle, keys.private).signature
    arguments = ["verify", "key", copied_bundle, "--signature", signature, "--public_key", keys.public]
    assert call_model_signing(*arguments) == 0
    (copied_bundle / "extra").touch()
    assert call_model_signing(*arguments) != 0


def test_a_signature_of_model_signing_is_verified_but_leaves_no_file_out(copied_bundle, keys, tmp_path):
    signature = tmp_path / "model.sig"
    arguments = ["sign", "key", copied_bundle, "--signature", signature, "--private_key", keys.private]
    assert call_model_signing(*arguments) == 0
    verify_bundle(copied_bundle, keys.public, signature)
    (copied_bundle / ".gitignore").touch()  # model_signing leaves it out
    with pytest.raises(ArtifactError, match=r"not signed: \.gitignore"):
        verify_bundle(copied_bundle, keys.public, signature)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_openssl_verifies_the_signed_list_of_hashes(copied_bundle, keys, tmp_path):
    """The format is DSSE: the signature covers the text "DSSEv1", and the type and the payload with their lengths."""
    envelope = json.loads(sign_bundle(copied_bundle, keys.private).signature.read_text())["dsseEnvelope"]
    kind, payload = envelope["payloadType"].encode(), base64.b64decode(envelope["payload"])
    (tmp_path / "message").write_bytes(b"DSSEv1 %d %s %d %s" % (len(kind), kind, len(payload), payload))
    (tmp_path / "raw").write_bytes(base64.b64decode(envelope["signatures"][0]["sig"]))
    command = [
        "openssl",
        "dgst",
        "-sha256",
        "-verify",
        keys.public,
        "-signature",
        tmp_path / "raw",
        tmp_path / "message",
    ]
    subprocess.run(command, check=True, capture_output=True)
    hashes = {entry["name"]: entry["digest"] for entry in json.loads(payload)["predicate"]["resources"]}
    printed = subprocess.run(
        ["sha256sum", *sorted(hashes)], cwd=copied_bundle, capture_output=True, text=True, check=True
    ).stdout
    assert printed == "".join(f"{hashes[name]}  {name}\n" for name in sorted(hashes))


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_the_commands_of_the_documentation_page_work(copied_bundle, tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "sign.md").read_text()
    lines = re.findall(r"^(?:openssl|duospacenet) .*", page, re.MULTILINE)
    assert len(lines) == 4
    for line in lines:
        program, *arguments = shlex.split(line)
        command = [*COMMAND, *arguments] if program == "duospacenet" else [program, *arguments]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{line}\n{done.stderr}"


# --- what is refused ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "place", ["bundle/bundle.sig", "bundle/sub/bundle.sig", "link/bundle.sig", "bundle/../bundle/x"]
)
def test_a_signature_inside_the_bundle_is_refused(copied_bundle, keys, tmp_path, place):
    (tmp_path / "link").symlink_to(copied_bundle)
    for refused in (sign_bundle, verify_bundle):
        with pytest.raises(UsageError, match="expected a file outside the bundle"):
            refused(copied_bundle, keys[refused is verify_bundle], tmp_path / place)


def test_the_default_place_is_beside_a_bundle_that_is_named_by_a_link_or_a_dot(
    copied_bundle, keys, tmp_path, monkeypatch
):
    (tmp_path / "link").symlink_to(copied_bundle)
    assert sign_bundle(tmp_path / "link", keys.private).signature == tmp_path / "bundle.sig"
    monkeypatch.chdir(copied_bundle)
    assert verify_bundle(".", keys.public).signature == tmp_path / "bundle.sig"


def test_an_existing_file_is_replaced_only_if_asked(copied_bundle, keys, tmp_path):
    (tmp_path / "bundle.sig").write_text("mine")
    with pytest.raises(OutputError, match="exists already"):
        sign_bundle(copied_bundle, keys.private)
    assert (tmp_path / "bundle.sig").read_text() == "mine"
    sign_bundle(copied_bundle, keys.private, overwrite=True)
    verify_bundle(copied_bundle, keys.public)


def test_a_damaged_bundle_is_not_signed(copied_bundle, keys, tmp_path):
    with (copied_bundle / "decoder.onnx").open("ab") as file:
        file.write(b"\0")
    with pytest.raises(ArtifactError, match=r"decoder\.onnx"):
        sign_bundle(copied_bundle, keys.private)
    assert not (tmp_path / "bundle.sig").exists()


@pytest.mark.parametrize("curve", ["RSA", "secp256k1"])
def test_keys_that_model_signing_cannot_use_are_refused(copied_bundle, tmp_path, curve):
    keys = make_keys(tmp_path, curve=curve)
    with pytest.raises(InputError, match="expected an elliptic-curve key on P-256, P-384, P-521"):
        sign_bundle(copied_bundle, keys.private)
    with pytest.raises(InputError, match="expected an elliptic-curve key on P-256, P-384, P-521"):
        verify_bundle(copied_bundle, keys.public)


def test_exchanged_keys_and_other_files_are_refused_with_the_command_that_makes_a_key(copied_bundle, keys, tmp_path):
    (tmp_path / "empty").touch()
    for path in (keys.public, tmp_path / "empty", copied_bundle / "decoder.onnx"):
        with pytest.raises(InputError, match=r"expected .*(private key|at most)"):
            sign_bundle(copied_bundle, path)
    for path in (keys.private, tmp_path / "empty"):
        with pytest.raises(InputError, match=r"expected a public key in PEM format.* openssl pkey"):
            verify_bundle(copied_bundle, path)
    for call in (sign_bundle, verify_bundle):
        with pytest.raises(InputError, match="no such file"):
            call(copied_bundle, tmp_path / "missing")


def test_a_folder_that_is_missing_is_refused(keys, tmp_path):
    for call, key in ((sign_bundle, keys.private), (verify_bundle, keys.public)):
        with pytest.raises(ArtifactError):
            call(tmp_path / "missing", key)


def test_names_of_added_files_are_printed_without_control_characters(copied_bundle, keys):
    sign_bundle(copied_bundle, keys.private)
    (copied_bundle / "\x1b[2Jred").touch()
    with pytest.raises(ArtifactError) as caught:
        verify_bundle(copied_bundle, keys.public)
    assert str(caught.value).isprintable()
