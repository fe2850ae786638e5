"""The README of a model repository: how to start the server, what to install, and the rules for clients."""

from collections.abc import Iterable

from duospacenet import __version__  # absolute: package/__init__.py is not beside this folder

from ...runtime.bundle.manifest import Manifest
from .serving_options import ServingOptions
from .serving_tensors import ANY, INPUTS, ServingTensor, serving_outputs


def readme_text(manifest: Manifest, options: ServingOptions) -> str:
    """Return the README of a model repository as Markdown."""
    return f"""\
# Model repository for Triton: `{options.name}`

Detects objects for up to {options.vehicles} vehicles at the same time, with the bundle in
`{options.name}/1/bundle` (preset {manifest.preset}, {manifest.precision}).
Written by `duospacenet package triton` {__version__}.

## Start the server

The model needs the base install of `duospacenet` {__version__}, without PyTorch. The official container does not have
it. So build an image with this `Dockerfile`, in a folder with the toolkit's wheel:

```dockerfile
FROM nvcr.io/nvidia/tritonserver:25.08-py3
COPY duospacenet-*.whl /tmp/
RUN pip install --break-system-packages /tmp/duospacenet-*.whl
```

```sh
docker build -t duospacenet-triton .
docker run --rm --shm-size 1g -p 127.0.0.1:8001:8001 -v "$PWD":/models:ro duospacenet-triton \\
  tritonserver --model-repository /models
```

The first command runs in the folder of the `Dockerfile`, the second one in this folder. Use Triton 24.12
or later: earlier releases do not support numpy 2, and the model refuses to load there. The frames pass through shared
memory, so `--shm-size` is needed.

Then check the server:

```sh
pip install 'tritonclient[grpc]'
python check_sequences.py --url localhost:8001 --model {options.name}
```

`--free` also takes all places and waits for the idle time, so use it only while no vehicle is connected.
Triton has no login: everyone who can reach the port can use the server. Keep it in a private network.

## Rules for clients

- A vehicle is a sequence: every request has the same `sequence_id`, a number above 0 or a text of up to 128 characters.
- The first frame has `sequence_start`, the last one `sequence_end`. Without a start, Triton refuses the frame.
- Send the next frame after the answer to the last one. Frames must be in the order of their times.
- A frame that is refused changes nothing. A frame whose answer was lost, or that the client cancelled, may have been
  processed: send the next one.
- After {options.idle_s:g} s without a frame, the sequence is lost. Start again: the history is then empty.
- If all {options.sequences_per_instance * options.instances} places are taken, a new vehicle waits for one. With the
  request's `timeout` [µs] it is refused after that time.
- A start with the id of a sequence in progress restarts it with an empty history. So no two vehicles may have the same
  id.

## Inputs

{_table(INPUTS)}

Extrinsics map points from the ego frame to the camera frame. Leave out cameras that the rig does not have. A lost
camera has its name and calibration, but no image bytes. Cameras may have any names and any order, which may change
between frames.

## Outputs

{_table(serving_outputs(manifest))}

Maps are only computed for a request that asks for them.

Classes: {_names(manifest.classes)}.
"""


def _table(tensors: Iterable[ServingTensor]) -> str:
    rows = [f"| `{tensor.name}` | {tensor.dtype} | {_shape(tensor)} | {_meaning(tensor)} |" for tensor in tensors]
    return "\n".join(["| tensor | type | shape | content |", "| --- | --- | --- | --- |", *rows])


def _shape(tensor: ServingTensor) -> str:
    return " × ".join("any" if length == ANY else str(length) for length in tensor.dims)


def _meaning(tensor: ServingTensor) -> str:
    return f"{tensor.meaning} (optional)" if tensor.optional else tensor.meaning


def _names(names: Iterable[str]) -> str:
    return ", ".join(f"{index} {name}" for index, name in enumerate(names))
