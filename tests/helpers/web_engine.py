"""The folder with the npm package onnxruntime-web, for tests that need it."""

from pathlib import Path

import pytest

from duospacenet.runtime.web_session import FOLDER_VARIABLE, web_package_folder

BROWSER_CONSUMER = Path(__file__).parents[2] / "consumers" / "browser"


@pytest.fixture
def web_engine(monkeypatch: pytest.MonkeyPatch) -> Path:
    """Use the onnxruntime-web of the browser consumer, or one that is installed for this user. Skips without either."""
    for folder in (BROWSER_CONSUMER, web_package_folder()):
        if (folder / "node_modules" / "onnxruntime-web").is_dir():
            monkeypatch.setenv(FOLDER_VARIABLE, str(folder))
            return folder
    pytest.skip("onnxruntime-web is not installed: npm ci --prefix consumers/browser")
