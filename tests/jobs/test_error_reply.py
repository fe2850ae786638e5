"""Errors that pass from a process to the one that started it."""

import json

import pytest

from duospacenet.data.scene_folder import NotASceneFolderError
from duospacenet.jobs.error_reply import check_reply, error_reply
from duospacenet.runtime.errors import ArtifactError, InputError


def test_an_error_is_raised_again_with_its_class_and_message():
    reply = json.loads(json.dumps(error_reply(ArtifactError("bundle: damaged"))))
    with pytest.raises(ArtifactError, match=r"^bundle: damaged$"):
        check_reply(reply)


def test_an_error_of_another_module_is_raised_as_its_nearest_known_class():
    with pytest.raises(InputError, match=r"^no scene$") as caught:
        check_reply(error_reply(NotASceneFolderError("no scene")))
    assert type(caught.value) is InputError


def test_a_reply_without_an_error_is_accepted():
    check_reply({"frames": 3})
