"""`config.pbtxt`: how Triton schedules the requests of many sequences, and the tensors that it checks.

The reasons for its settings are in docs/serving.md.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

from duospacenet import __version__  # absolute: package/__init__.py is not beside this folder

from ...runtime.bundle.manifest import Manifest
from ...runtime.errors import UsageError
from .serving_options import ServingOptions
from .serving_tensors import END, INPUTS, START, ServingTensor, serving_outputs

Number = TypeVar("Number", int, float)

_PRINTABLE = range(0x20, 0x7F)


def config_text(manifest: Manifest, options: ServingOptions) -> str:
    """Return the model configuration of a bundle in protobuf's text format."""
    idle_us = round(1e6 * options.idle_s)
    return f"""\
name: {_quoted(options.name)}
backend: "python"
max_batch_size: 0  # a request is one frame of one vehicle

input [
{_tensors(INPUTS)}
]
output [
{_tensors(serving_outputs(manifest))}
]

sequence_batching {{
  max_sequence_idle_microseconds: {idle_us}
  oldest {{ max_candidate_sequences: {options.sequences_per_instance} }}
  control_input [
    {{ name: "{START}" control [ {{ kind: CONTROL_SEQUENCE_START fp32_false_true: [ 0, 1 ] }} ] }},
    {{ name: "{END}" control [ {{ kind: CONTROL_SEQUENCE_END fp32_false_true: [ 0, 1 ] }} ] }}
  ]
}}
instance_group [ {{ kind: KIND_CPU count: {options.instances} }} ]

{_parameters(manifest, options)}
"""


def read_options(config: Mapping[str, Any]) -> ServingOptions:
    """Return the options in a model configuration that Triton has read.

    config: its JSON, in which numbers may be texts.
    Raises UsageError for a setting that was edited to something that the model cannot use.
    """
    batching = config.get("sequence_batching", {})
    if "oldest" not in batching:
        raise UsageError("config.pbtxt: sequence_batching: expected the strategy oldest. Package the bundle again.")
    instances = sum(int(group["count"]) for group in config["instance_group"])
    settings = {name: value["string_value"] for name, value in config["parameters"].items()}
    return ServingOptions(
        name=config["name"],
        vehicles=int(batching["oldest"]["max_candidate_sequences"]) * instances,
        idle_s=float(batching["max_sequence_idle_microseconds"]) / 1e6,
        instances=instances,
        threads=_number(settings, "threads", int),
        on_missing=settings.get("on_missing", ""),
        history_step_s=_number(settings, "history_step_s", float),
    )


def _number(settings: Mapping[str, str], name: str, convert: Callable[[str], Number]) -> Number | None:
    """A setting as a number; None for an empty text."""
    text = settings.get(name, "")
    try:
        return convert(text) if text else None
    except ValueError:
        raise UsageError(f"config.pbtxt: parameter {name}: expected a number or nothing; got {text[:60]!r}.") from None


def _tensors(tensors: Iterable[ServingTensor]) -> str:
    return ",\n".join(_tensor(tensor) for tensor in tensors)


def _tensor(tensor: ServingTensor) -> str:
    dims = ", ".join(map(str, tensor.dims))
    optional = " optional: true" if tensor.optional else ""
    return f"  {{ name: {_quoted(tensor.name)} data_type: {tensor.dtype} dims: [ {dims} ]{optional} }}"


def _parameters(manifest: Manifest, options: ServingOptions) -> str:
    """The settings that the model reads, and the names that a client needs."""
    values = {
        "threads": "" if options.threads is None else str(options.threads),  # empty: a share of the cores
        "on_missing": options.on_missing,
        "history_step_s": "" if options.history_step_s is None else repr(options.history_step_s),
        "classes": json.dumps(manifest.classes),
        "map_classes": json.dumps(manifest.map_classes),
        "duospacenet": __version__,
    }
    return "\n".join(
        f"parameters {{ key: {_quoted(key)} value {{ string_value: {_quoted(value)} }} }}"
        for key, value in values.items()
    )


def _quoted(text: str) -> str:
    """A string literal. Bytes outside printable ASCII are octal escapes, so that no name can end the literal."""
    escaped = (f"\\{byte:03o}" if byte not in _PRINTABLE or byte in b'"\\' else chr(byte) for byte in text.encode())
    return f'"{"".join(escaped)}"'
