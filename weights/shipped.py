"""The trained weights that are part of the toolkit. The metadata of each file says how it was trained."""

from pathlib import Path


def shipped_weights(preset: str) -> Path:
    """The safetensors file with the trained weights of `preset`. Raises FileNotFoundError if there is none."""
    path = Path(__file__).with_name(f"{preset}.safetensors")
    if not path.is_file():
        available = ", ".join(sorted(file.stem for file in path.parent.glob("*.safetensors")))
        raise FileNotFoundError(f"expected a preset with trained weights, {available}; got {preset!r}")
    return path
