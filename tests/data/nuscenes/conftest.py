"""Each test has a cache folder of its own."""

import pytest


@pytest.fixture(autouse=True)
def cache_folder(tmp_path_factory, monkeypatch):
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("DUOSPACENET_CACHE", str(folder))
    return folder
