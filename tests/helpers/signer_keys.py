"""Keys of signers, as PEM files."""

from pathlib import Path
from typing import NamedTuple

import pytest


class Keys(NamedTuple):
    private: Path
    public: Path


def make_keys(folder: Path, name: str = "signer", curve: str = "P-256", password: str | None = None) -> Keys:
    """A new pair of keys. Skips the test if `cryptography` is not installed.

    curve: P-256, P-384, P-521 or another name below; "RSA" for a key of another kind.
    """
    pytest.importorskip("cryptography")
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ec, rsa

    curves = {"P-256": ec.SECP256R1, "P-384": ec.SECP384R1, "P-521": ec.SECP521R1, "secp256k1": ec.SECP256K1}
    key = rsa.generate_private_key(65537, 2048) if curve == "RSA" else ec.generate_private_key(curves[curve]())
    protection = serialization.BestAvailableEncryption(password.encode()) if password else serialization.NoEncryption()
    keys = Keys(folder / f"{name}.key", folder / f"{name}.pub")
    keys.private.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, protection)
    )
    keys.public.write_bytes(
        key.public_key().public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    )
    return keys
