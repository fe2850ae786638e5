"""The sizes of installed distributions, on a hand-made environment."""

from pathlib import Path

from benchmarks.installed_sizes import installed_sizes


def install(site_packages: Path, name: str, files: dict[str, int]) -> int:
    """Write the files of a distribution, of the given sizes, and its metadata. Returns the size of the metadata."""
    info = site_packages / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    for file, size in files.items():
        path = site_packages / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(size))
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    listed = [*files, f"{info.name}/METADATA", f"{info.name}/RECORD"]
    (info / "RECORD").write_text("".join(f"{file},,\n" for file in listed))
    return sum(path.stat().st_size for path in info.iterdir())


def test_every_file_is_counted_once_with_its_distribution(tmp_path):
    site = tmp_path / "lib" / "site-packages"
    first = install(site, "first", {"first/code.py": 700, "first/data/table.bin": 300, "../../bin/first": 50})
    second = install(site, "second", {"second.py": 20, "first/code.py": 700})
    (site / "second.pyc").write_bytes(bytes(5))
    sizes = installed_sizes(site)
    shared = 700
    assert sizes.pop("no distribution") == 5
    assert sum(sizes.values()) == 700 + 300 + 50 + 20 + first + second
    assert sizes["first 1.0"] in (1050 + first, 1050 - shared + first)  # the order of the distributions is not fixed


def test_a_listed_file_that_is_gone_counts_nothing(tmp_path):
    metadata = install(tmp_path, "first", {"first.py": 700})
    (tmp_path / "first.py").unlink()
    assert installed_sizes(tmp_path) == {"first 1.0": metadata, "no distribution": 0}
