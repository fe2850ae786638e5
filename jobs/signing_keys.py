"""The keys of signatures: PEM files of elliptic-curve keys. Needs the extra `sign`."""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..runtime.errors import InputError
from ..runtime.extras import needs_extra
from ..runtime.files import read_regular_file

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePublicKey

CURVES = {"secp256r1": "P-256", "secp384r1": "P-384", "secp521r1": "P-521"}  # those of model-signing
MAX_KEY_BYTES = 2**16
_NEW_KEY = "Make one: openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out signer.key"
_NEW_PUBLIC_KEY = "Make it from the private key: openssl pkey -in signer.key -pubout -out signer.pub"


def check_private_key(path: Path, password: str | None = None) -> str:
    """Check a private key, and return the SHA-256 hash of its public key. Raises InputError."""
    with needs_extra("sign"):
        from cryptography.exceptions import UnsupportedAlgorithm
        from cryptography.hazmat.primitives.serialization import load_pem_private_key
    content = read_regular_file(path, MAX_KEY_BYTES, InputError)
    try:
        key = load_pem_private_key(content, password.encode() if password else None)
    except TypeError:  # with or without a password, and the key is the other way round
        expected = "no password; the key is not encrypted" if password else "the password of this encrypted key"
        raise InputError(f"{path}: expected {expected}. Set or unset DUOSPACENET_KEY_PASSWORD.") from None
    except (ValueError, UnsupportedAlgorithm) as error:
        if password:
            raise InputError(f"{path}: cannot be decrypted. Check DUOSPACENET_KEY_PASSWORD.") from error
        raise InputError(f"{path}: expected a private key in PEM format; got another file. {_NEW_KEY}") from error
    return _sha256(_check_curve(path, key.public_key()))


def public_key_sha256(path: Path) -> str:
    """Check a public key, and return its SHA-256 hash as a PEM file. Raises InputError."""
    with needs_extra("sign"):
        from cryptography.exceptions import UnsupportedAlgorithm
        from cryptography.hazmat.primitives.serialization import load_pem_public_key
    content = read_regular_file(path, MAX_KEY_BYTES, InputError)
    try:
        key = load_pem_public_key(content)
    except (ValueError, UnsupportedAlgorithm) as error:
        raise InputError(f"{path}: expected a public key in PEM format; got another file. {_NEW_PUBLIC_KEY}") from error
    return _sha256(_check_curve(path, key))


def _check_curve(path: Path, key: Any) -> "EllipticCurvePublicKey":
    curve = getattr(getattr(key, "curve", None), "name", type(key).__name__)
    if curve not in CURVES:
        raise InputError(
            f"{path}: expected an elliptic-curve key on {', '.join(CURVES.values())}; got {curve}. {_NEW_KEY}"
        )
    return key


def _sha256(key: "EllipticCurvePublicKey") -> str:
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    return hashlib.sha256(key.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)).hexdigest()
