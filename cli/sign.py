"""`duospacenet sign`: sign a bundle with a private key."""

import os
from pathlib import Path
from typing import Annotated

import typer

from .console import print_json, print_message
from .options import BEHAVIOUR, INPUT, OUTPUT, BundleArgument, JsonOption

PASSWORD_VARIABLE = "DUOSPACENET_KEY_PASSWORD"

PrivateKeyOption = Annotated[
    Path,
    typer.Option(
        help=f"PEM file of an elliptic-curve private key. {PASSWORD_VARIABLE} holds the password of an encrypted key.",
        metavar="FILE",
        rich_help_panel=INPUT,
    ),
]
SignatureOption = Annotated[
    Path | None,
    typer.Option(
        help="New file of the signature, outside the bundle. Default: BUNDLE.sig beside the bundle.",
        metavar="FILE",
        rich_help_panel=OUTPUT,
    ),
]
OverwriteOption = Annotated[
    bool, typer.Option("--overwrite", help="Replace an existing signature.", rich_help_panel=BEHAVIOUR)
]


def sign(
    bundle: BundleArgument,
    private_key: PrivateKeyOption,
    signature: SignatureOption = None,
    overwrite: OverwriteOption = False,
    as_json: JsonOption = False,
) -> None:
    """Sign the files of a bundle with a private key. The signature proves who made the bundle.

    \b
    Example:
      duospacenet sign out/bundle --private-key signer.key
    """
    from ..jobs.signing import sign_bundle

    password = os.environ.get(PASSWORD_VARIABLE)
    signed = sign_bundle(bundle, private_key, signature, password=password, overwrite=overwrite)
    if as_json:
        print_json(signed.to_dict())
    else:
        print_message(f"wrote {signed.signature}: {len(signed.files)} files, signed by the key {signed.key_sha256}")
