"""The configuration in a manifest has the fields and limits of the model's configuration."""

from typing import Any

import pytest
from pydantic import TypeAdapter

from duospacenet.model import PRESETS, DuoSpaceNetConfig
from duospacenet.runtime.bundle.model_config import ModelConfig


def resolved(schema: Any, definitions: dict[str, Any]) -> Any:
    """A JSON Schema with its references filled in, and without names, texts, defaults and the fields that need one."""
    if isinstance(schema, list):
        return [resolved(part, definitions) for part in schema]
    if not isinstance(schema, dict):
        return schema
    if "$ref" in schema:
        return resolved(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    texts = {"$defs", "title", "description", "default", "required"}
    return {
        key: {name: resolved(field, definitions) for name, field in part.items()}
        if key == "properties"
        else resolved(part, definitions)
        for key, part in schema.items()
        if key not in texts
    }


def test_the_fields_and_their_limits_are_those_of_the_model_and_a_deprecated_one():
    record, model = ModelConfig.model_json_schema(), TypeAdapter(DuoSpaceNetConfig).json_schema()
    deprecated = record["properties"].pop("relu_before_extra_level")
    assert (deprecated["type"], deprecated["deprecated"]) == ("boolean", True)
    assert resolved(record, record["$defs"]) == resolved(model, model["$defs"])


@pytest.mark.parametrize("preset", PRESETS)
def test_the_configuration_of_every_preset_is_read_unchanged(preset):
    values = PRESETS[preset].to_dict()
    assert ModelConfig.model_validate(values).model_dump(mode="json", exclude_unset=True) == values
