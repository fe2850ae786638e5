"""Folders that hold a checkpoint: which file in them to read, or what else they are."""

import shlex
from pathlib import Path

from .checkpoint_error import CheckpointError

# The names that Hugging Face libraries read from a folder, in their order.
_WHOLE_FILES = ("model.safetensors", "pytorch_model.bin")
_INDICES = ("*.safetensors.index.json", "*.bin.index.json")
_SUFFIXES = (".safetensors", ".pth", ".pt", ".ckpt", ".bin")


def find_checkpoint(path: Path) -> Path:
    """The file to read for a path: the path itself, or the checkpoint or the index of shards in a folder.

    Raises CheckpointError for a folder of another kind, or with several checkpoints, and FileNotFoundError for a path
    without a file or a folder without a checkpoint.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path}: expected a checkpoint, .safetensors or .pth; got no such file.")
    if not path.is_dir():
        _check_not_distributed(path.parent, path)
        return path
    for pattern in (*_INDICES, *_WHOLE_FILES):
        found = sorted(path.glob(pattern))
        if len(found) > 1:
            names = ", ".join(file.name for file in found)
            raise CheckpointError(f"{path}: expected one checkpoint in the folder; got {names}. Name one of them.")
        if found:
            return found[0]
    _check_not_distributed(path, path)
    _check_not_deepspeed(path)
    _check_not_another_model(path)
    files = [file.name for file in sorted(path.iterdir()) if file.suffix in _SUFFIXES and file.name.isprintable()]
    advice = f" Name a file in it: {', '.join(files[:5])}." if files else ""
    raise FileNotFoundError(f"{path}: expected a checkpoint, .safetensors or .pth; got a folder.{advice}")


def _check_not_distributed(folder: Path, path: Path) -> None:
    """Refuse a folder of torch.distributed.checkpoint, or one of its files."""
    is_part = path.is_dir() or path.suffix == ".distcp" or path.name == ".metadata"
    if is_part and (folder / ".metadata").exists() and any(folder.glob("*.distcp")):
        convert = f"python -m torch.distributed.checkpoint.format_utils dcp_to_torch {_quote(folder)} tensors.pth"
        raise CheckpointError(
            f"{path}: expected .safetensors or a weights-only .pth; got a distributed checkpoint, as FSDP saves it. "
            f"If you trust it, convert it with `{convert}`."
        )


def _check_not_deepspeed(folder: Path) -> None:
    script = folder / "zero_to_fp32.py"
    if script.exists() or any(folder.glob("*zero_pp_rank_*")) or any(folder.glob("mp_rank_*_model_states.pt")):
        program = _quote(script) if script.exists() else "-m deepspeed.utils.zero_to_fp32"
        raise CheckpointError(
            f"{folder}: expected .safetensors or a weights-only .pth; got a checkpoint of DeepSpeed, in parts. "
            f"If you trust it, convert it with `python {program} {_quote(folder)} converted`, and name the result."
        )


def _check_not_another_model(folder: Path) -> None:
    if (folder / "saved_model.pb").exists():
        raise CheckpointError(f"{folder}: expected weights of PyTorch; got a TensorFlow SavedModel.")
    if (folder / "manifest.json").exists() and any(folder.glob("*.onnx")):
        raise CheckpointError(
            f"{folder}: expected a checkpoint; got a bundle, which holds graphs. Name the weights it was exported from."
        )


def _quote(path: Path) -> str:
    return shlex.quote(str(path))
