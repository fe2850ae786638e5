"""Trained weights that come with the toolkit: a file a preset, with its provenance in the file's metadata."""

from pathlib import Path


def shipped_weights(preset: str) -> Path:
    """The file of `preset`, safetensors. Raises FileNotFoundError where none ships."""
    path = Path(__file__).with_name(f"{preset}.safetensors")
    if not path.is_file():
        raise FileNotFoundError(f"no trained weights of preset {preset!r} ship with this toolkit")
    return path
