"""The telemetry of onnxruntime and OpenVINO, which this toolkit switches off.

onnxruntime's wheels for Linux since 1.29 write a device id and a database to the user's cache folder when they are
imported, and send events over the network some seconds later. OpenVINO sends an event over the network when it is
imported.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

VARIABLE = "ORT_DISABLE_TELEMETRY"


def disable_telemetry() -> None:
    """Switch onnxruntime's telemetry off, unless the user has set ORT_DISABLE_TELEMETRY, to any value.

    onnxruntime reads the variable once, when it is imported. If it was imported earlier, this only asks it to record no
    further events: its files exist by then, and it still looks up its host.
    """
    if VARIABLE in os.environ:
        return
    os.environ[VARIABLE] = "1"
    disable_events = getattr(sys.modules.get("onnxruntime"), "disable_telemetry_events", None)
    if disable_events is not None:
        disable_events()


@contextmanager
def without_openvino_telemetry() -> Iterator[None]:
    """Wrap the first import of `openvino`. The package that sends its events cannot be imported in the block.

    OpenVINO then uses the stub that it has for installations without that package.
    """
    package = "openvino_telemetry"
    if package in sys.modules:  # openvino was imported earlier
        yield
        return
    sys.modules[package] = None  # type: ignore[assignment]  # Python's mark of a module that cannot be imported
    try:
        yield
    finally:
        del sys.modules[package]
