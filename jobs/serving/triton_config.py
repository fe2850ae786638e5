"""`config.pbtxt`: how Triton schedules the requests of many sequences, and the tensors that it checks.

The reasons for its settings are in docs/serving.md.
"""

import json
from collections.abc import Iterable

from duospacenet import __version__  # absolute: package/__init__.py is not beside this folder

from ...runtime.bundle.manifest import Manifest
from .serving_options import ServingOptions
from .serving_tensors import INPUTS, ServingTensor, serving_outputs
from .triton_model import END, START

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
