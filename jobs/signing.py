"""Signatures of bundles. A signature proves that the holder of a private key signed exactly these files.

The signature is a file beside the bundle, in the format of the package `model-signing` of the OpenSSF, which makes and
verifies it. Its own command line can verify it too.
"""

import base64
import contextlib
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..runtime.errors import ArtifactError, OutputError, UsageError
from ..runtime.extras import needs_extra
from ..runtime.files import atomic_path, read_regular_file
from ..runtime.printable import printable
from .folder_files import files_below
from .inspection import inspect_bundle
from .signing_keys import check_private_key, public_key_sha256

if TYPE_CHECKING:
    from model_signing import hashing

MAX_SIGNATURE_BYTES = 2**20


@dataclass(frozen=True)
class SignedBundle:
    """A bundle that a signature covers.

    files: the paths in the bundle; all of them are signed.
    key_sha256: the SHA-256 hash of the public key as a PEM file.
    """

    bundle: Path
    signature: Path
    files: tuple[str, ...]
    key_sha256: str

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return {**vars(self), "bundle": str(self.bundle), "signature": str(self.signature), "files": list(self.files)}


def sign_bundle(
    bundle: str | Path,
    private_key: str | Path,
    signature: str | Path | None = None,
    *,
    password: str | None = None,
    overwrite: bool = False,
) -> SignedBundle:
    """Sign every file of a bundle, and write the signature to a file.

    private_key: PEM file of an elliptic-curve key on P-256, P-384 or P-521.
    signature: the new file, outside the bundle; None for `BUNDLE.sig` beside it.
    password: of an encrypted key.
    overwrite: replace an existing file.
    Raises ArtifactError for a bundle that `inspect` refuses, InputError for the key, and OutputError.
    """
    with needs_extra("sign"):
        from model_signing import hashing, signing
    bundle, private_key = Path(bundle), Path(private_key)
    signature = _signature_path(bundle, signature)
    key_sha256 = check_private_key(private_key, password)
    if signature.exists() and not overwrite:
        raise OutputError(f"{signature}: this file exists already. Choose another --signature, or add --overwrite.")
    inspect_bundle(bundle)
    files = files_below(bundle)
    every_file = hashing.Config().set_ignored_paths(paths=(), ignore_git_paths=False)
    config = signing.Config().set_hashing_config(every_file)
    # model-signing 1.1.1 declares str, but passes the password on to `cryptography`, which takes bytes only.
    secret: Any = password.encode() if password else None
    config.use_elliptic_key_signer(private_key=private_key, password=secret)
    with atomic_path(signature) as temporary:
        config.sign(bundle.resolve(), temporary)
    return SignedBundle(bundle, signature, files, key_sha256)


def verify_bundle(bundle: str | Path, public_key: str | Path, signature: str | Path | None = None) -> SignedBundle:
    """Check that a bundle consists of exactly the files that the holder of a key has signed.

    public_key: PEM file of the signer's public key.
    signature: None for `BUNDLE.sig` beside the bundle.
    Raises ArtifactError if the key, the signature and the files do not belong together. Raises InputError for a file
    that is no public key.
    """
    with needs_extra("sign"):
        import model_signing  # noqa: F401
    bundle, public_key = Path(bundle), Path(public_key)
    signature = _signature_path(bundle, signature)
    key_sha256 = public_key_sha256(public_key)
    content = read_regular_file(signature, MAX_SIGNATURE_BYTES, ArtifactError)
    files = files_below(bundle)
    try:
        signed = _verify(bundle, public_key, content)
    except OSError:
        raise
    except Exception as error:  # malformed files cause errors of json, pydantic and other libraries
        if str(error).startswith("Signature mismatch"):  # verified, but it is for other files
            raise ArtifactError(_describe_difference(bundle, files, content)) from None
        raise ArtifactError(_describe_failure(public_key, signature, error)) from error
    if {*files} - signed:  # another tool has signed the bundle with a list of files to ignore
        raise ArtifactError(_describe_difference(bundle, files, content))
    return SignedBundle(bundle, signature, files, key_sha256)


def _verify(bundle: Path, public_key: Path, signature: bytes) -> set[str]:
    """Verify a signature and the hashes of the files, and return the names of the signed files.

    Raises ValueError for other files, and any exception for another key or a malformed signature.
    """
    from model_signing import verifying

    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(sys.stderr):
        copy = Path(folder) / "signature"  # the same bytes are read here and verified
        copy.write_bytes(signature)
        config = verifying.Config().set_hashing_config(_hashing_config(signature))
        config.use_elliptic_key_verifier(public_key=public_key).verify(bundle.resolve(), copy)
    return _signed_names(signature)


def _signature_path(bundle: Path, signature: str | Path | None) -> Path:
    """The path of the signature. Raises UsageError if it is inside the bundle."""
    path = Path(f"{bundle.resolve()}.sig") if signature is None else Path(signature)
    if path.resolve().is_relative_to(bundle.resolve()):
        raise UsageError(f"--signature: expected a file outside the bundle; got {path}. Choose one beside the bundle.")
    return path


def _read_statement(signature: bytes) -> dict[str, Any]:
    """What was signed: the hash method, and the name and hash of each file. Any exception if it is malformed."""
    return json.loads(base64.b64decode(json.loads(signature)["dsseEnvelope"]["payload"]))["predicate"]


def _signed_names(signature: bytes) -> set[str]:
    statement = _read_statement(signature)
    names = {str(resource["name"]) for resource in statement["resources"]}
    if statement["serialization"]["method"] == "shards":  # NAME:START:END
        return {name.rsplit(":", 2)[0] for name in names}
    return names


def _hashing_config(signature: bytes) -> "hashing.Config":
    """The hash method of a signature. By default, model-signing would leave out files such as .gitignore."""
    from model_signing import hashing

    method = _read_statement(signature)["serialization"]
    config = hashing.Config().set_ignored_paths(paths=(), ignore_git_paths=False)
    if method["method"] == "shards":
        return config.use_shard_serialization(hashing_algorithm=method["hash_type"], shard_size=method["shard_size"])
    return config.use_file_serialization(hashing_algorithm=method["hash_type"])


def _describe_difference(bundle: Path, files: tuple[str, ...], signature: bytes) -> str:
    """The files that differ from those of a signature, which has been verified."""
    expected = {resource["name"]: resource["digest"] for resource in _read_statement(signature)["resources"]}
    hashed = _hashing_config(signature).hash(bundle.resolve()).resource_descriptors()
    actual = {resource.identifier: resource.digest.digest_hex for resource in hashed}
    signed = _signed_names(signature)
    names = {
        "changed": sorted(name for name in expected.keys() & actual if expected[name] != actual[name]),
        "not signed": sorted({*files} - signed),
        "missing": sorted(signed - {*files}),
    }
    found = "; ".join(f"{kind}: {', '.join(map(printable, some))}" for kind, some in names.items() if some)
    return f"{bundle}: expected exactly the files that were signed; {found}. Get the bundle from its source again."


def _describe_failure(public_key: Path, signature: Path, error: Exception) -> str:
    from cryptography.exceptions import InvalidSignature

    if isinstance(error, InvalidSignature) or str(error).startswith("Key mismatch"):
        return f"{signature}: made with another private key than that of {public_key}, or changed later."
    found = printable(f"{type(error).__name__}: {error}")
    return f"{signature}: expected a signature of `duospacenet sign`; it cannot be read ({found})."
