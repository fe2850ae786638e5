"""The results of a batch, without what differs between two batches: durations and names of workers."""

from pathlib import Path

from tests.helpers.output_files import contents


def scene_results(out: Path) -> dict[str, dict[str, bytes]]:
    """The files of each finished scene, by the name of its folder, as `run` would write them."""
    return {folder.name: files_of_run(folder) for folder in sorted((out / "scenes").iterdir())}


def files_of_run(folder: Path) -> dict[str, bytes]:
    """The files of a finished scene without its summary."""
    files = contents(folder)
    del files["summary.json"]
    return files
