"""Content hash: the sha256 of a safetensors file's tensors and metadata, stored as one metadata field.

The format has no hash of its own, so a changed byte of a weight would go undetected. Files of other programs lack the
field, and are not checked.
"""

import hashlib
import json
from collections.abc import Mapping

import torch
from torch import Tensor

HASH_KEY = "duospacenet.sha256"


def with_content_hash(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> dict[str, str]:
    """The metadata with the hash of the tensors and of the other metadata."""
    return {**metadata, HASH_KEY: _hash(tensors, metadata)}


def is_intact(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> bool:
    """Whether the hash in the metadata is that of the content. True without a hash."""
    return HASH_KEY not in metadata or metadata[HASH_KEY] == _hash(tensors, metadata)


def _hash(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> str:
    """The sha256 of the metadata without the hash, and of names, types, shapes and bytes of the tensors, all sorted."""
    digest = hashlib.sha256()
    fields = {name: value for name, value in metadata.items() if name != HASH_KEY}
    digest.update(json.dumps(fields, sort_keys=True).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(json.dumps([name, str(tensor.dtype), list(tensor.shape)]).encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().data)
    return digest.hexdigest()
