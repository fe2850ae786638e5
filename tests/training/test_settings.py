"""Tests of the training settings."""

import json

import pytest
from pydantic import ValidationError

from duospacenet.training import Settings


def test_settings_can_be_stored_as_json_and_read_back():
    settings = Settings(steps=7, batch_size=3, bev_supervision=False, seed=999)
    assert Settings.from_dict(json.loads(json.dumps(settings.to_dict()))) == settings


@pytest.mark.parametrize(
    ("changes", "field"),
    [({"steps": 0}, "steps"), ({"seed": 1000}, "seed"), ({"denoising": -1}, "denoising"), ({"epoch": 3}, "epoch")],
)
def test_an_invalid_or_unknown_field_is_refused_by_name(changes, field):
    with pytest.raises(ValidationError, match=field):
        Settings.from_dict({"steps": 4} | changes)


def test_pretraining_without_pv_supervision_is_refused():
    with pytest.raises(ValidationError, match="expected True with pretraining, which has no other loss"):
        Settings(steps=4, pretraining=True, pv_supervision=False)
