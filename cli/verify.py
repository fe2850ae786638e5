"""`duospacenet verify`: check a bundle against its signature."""

from pathlib import Path
from typing import Annotated

import typer

from .console import print_json, print_result
from .options import INPUT, BundleArgument, JsonOption

PublicKeyOption = Annotated[
    Path, typer.Option(help="PEM file of the signer's public key.", metavar="FILE", rich_help_panel=INPUT)
]
SignatureOption = Annotated[
    Path | None,
    typer.Option(
        help="File of the signature. Default: BUNDLE.sig beside the bundle.", metavar="FILE", rich_help_panel=INPUT
    ),
]


def verify(
    bundle: BundleArgument,
    public_key: PublicKeyOption,
    signature: SignatureOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check that a bundle has exactly the files that the holder of a key has signed.

    \b
    Example:
      duospacenet verify out/bundle --public-key signer.pub
    """
    from ..jobs.signing import verify_bundle

    signed = verify_bundle(bundle, public_key, signature)
    if as_json:
        print_json(signed.to_dict())
        return
    print_result(f"verified: all {len(signed.files)} files of {signed.bundle} are signed", markup=False, soft_wrap=True)
    print_result(f"by the key {signed.key_sha256}: {', '.join(signed.files)}", markup=False, soft_wrap=True)
