"""Sharded checkpoints of Hugging Face libraries: an index, and several files with a part of the tensors each."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import Field
from torch import Tensor

from ..runtime.json_record import JsonRecord, read_json
from .checkpoint_error import CheckpointError
from .checkpoint_format import MAX_INDEX_BYTES

_SHARD_NAME = re.compile(r"(?P<stem>.+)-(?P<number>\d{5,})-of-(?P<count>\d{5,})(?P<suffix>(\.\w+)+)")


ReadShard = Callable[[Path], tuple[Any, dict[str, str]]]  # reads one file: its content and its metadata


class ShardIndex(JsonRecord, extra="ignore"):
    """An index such as `model.safetensors.index.json`.

    weight_map: by tensor, the name of its file in the same folder.
    metadata: `total_size` is the number of bytes of all tensors.
    """

    weight_map: dict[str, str]
    metadata: dict[str, Any] = Field(default_factory=dict)


def find_shards(index: Path) -> dict[Path, list[str]]:
    """The names of the tensors in each shard, by the index. The files are sorted by name.

    Raises CheckpointError, naming the file, for a shard that is missing, outside the folder, or not in the index.
    """
    weight_map = read_json(index, ShardIndex, CheckpointError, MAX_INDEX_BYTES).weight_map
    if not weight_map:
        raise CheckpointError(f"{index}: field weight_map: expected the file of each tensor; got none.")
    shards: dict[Path, list[str]] = {}
    for tensor, name in sorted(weight_map.items(), key=lambda item: item[1]):
        _check_name(index, tensor, name)
        shards.setdefault(index.parent / name, []).append(tensor)
    _check_files(index, shards)
    return shards


def read_sharded(index: Path, read_shard: ReadShard) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Read all shards: their tensors by name, and the metadata that they share.

    Raises CheckpointError, naming the file, unless each shard has exactly the tensors that the index says.
    """
    tensors: dict[str, Tensor] = {}
    metadata: list[dict[str, str]] = []
    for path, names in find_shards(index).items():
        content, shard_metadata = read_shard(path)
        _check_tensors(index, path, names, content)
        tensors |= content
        metadata.append(shard_metadata)
    _check_total_size(index, tensors)
    shared = dict(set.intersection(*(set(items.items()) for items in metadata)))
    return tensors, shared


def check_not_a_shard(path: Path) -> None:
    """Raise CheckpointError if the name says that the file is one of several shards."""
    match = _SHARD_NAME.fullmatch(path.name)
    if match is None or int(match["count"]) < 2:
        return
    index = path.with_name(f"{match['stem']}{match['suffix']}.index.json")
    advice = f"Name the index {index}" if index.exists() else f"Copy the index {index.name} beside it and name that"
    raise CheckpointError(
        f"{path}: expected a whole checkpoint; by its name it is shard {int(match['number'])} of "
        f"{int(match['count'])}. {advice}."
    )


def _check_name(index: Path, tensor: str, name: str) -> None:
    if Path(name).name != name or name in ("", ".", "..") or "\\" in name or not name.isprintable():
        raise CheckpointError(
            f"{index}: field weight_map: expected the names of files in the same folder; got {name!r} for "
            f"{tensor!r}. Only read a checkpoint from a source that you trust."
        )


def _check_files(index: Path, shards: Mapping[Path, list[str]]) -> None:
    """Check that the folder has exactly the shards of the index."""
    names = {path.name for path in shards}
    for path in shards:
        if not path.exists():
            raise CheckpointError(f"{path}: expected a shard that {index.name} lists; got no such file. Copy it there.")
    for path in sorted(index.parent.iterdir()):
        match = _SHARD_NAME.fullmatch(path.name)
        if match and path.name not in names and any(_is_of_same_set(match, name) for name in names):
            raise CheckpointError(
                f"{path}: expected only the {len(names)} shards that {index.name} lists; got this one too. "
                "The index belongs to another version of the checkpoint: download both again."
            )
    for name in names:
        match = _SHARD_NAME.fullmatch(name)
        if match and int(match["count"]) != sum(_is_of_same_set(match, other) for other in names):
            raise CheckpointError(
                f"{index}: expected {int(match['count'])} shards, as the name {name} says; it lists {len(names)}. "
                "Download the index and the shards again."
            )


def _is_of_same_set(match: re.Match[str], name: str) -> bool:
    other = _SHARD_NAME.fullmatch(name)
    return other is not None and (other["stem"], other["suffix"]) == (match["stem"], match["suffix"])


def _check_tensors(index: Path, path: Path, names: list[str], content: Any) -> None:
    """Check that a shard holds exactly the tensors `names`."""
    if not isinstance(content, Mapping) or not all(isinstance(value, Tensor) for value in content.values()):
        raise CheckpointError(f"{path}: expected a shard with named tensors only; got {type(content).__name__}.")
    missing = sorted(set(names) - content.keys())
    extra = sorted(content.keys() - set(names), key=str)
    for kind, tensors in (("lacks", missing), ("also has", extra)):
        if tensors:
            raise CheckpointError(
                f"{path}: expected the {len(names)} tensors that {index.name} lists for it; it {kind} {tensors[0]!r} "
                f"({len(tensors)} in all). Download the index and the shards again."
            )


def _check_total_size(index: Path, tensors: Mapping[str, Tensor]) -> None:
    expected = read_json(index, ShardIndex, CheckpointError, MAX_INDEX_BYTES).metadata.get("total_size")
    sizes = [(tensor.data_ptr(), tensor.numel() * tensor.element_size()) for tensor in tensors.values()]
    # Two names may share one tensor in a pickle, which some writers count once.
    possible = (sum(size for _, size in sizes), sum(size for _, size in set(sizes)))
    if isinstance(expected, int) and expected not in possible:
        raise CheckpointError(
            f"{index}: field metadata.total_size: expected {possible[0]}, the bytes of all tensors; got {expected}. "
            "Download the index and the shards again."
        )
