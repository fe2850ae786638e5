"""Reads recordings back with the readers of their formats."""

from collections import defaultdict
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rerun.chunk import RrdReader

Messages = dict[str, list[tuple[int, Any]]]  # time [ns] and message by topic


def read_mcap(path: Path) -> Messages:
    """The messages of an MCAP file by topic, in the order of their times. The file must have its index."""
    messages: Messages = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        assert reader.get_summary() is not None
        for _, channel, message, decoded in reader.iter_decoded_messages():
            messages[channel.topic].append((message.log_time, decoded))
    return dict(messages)


def read_rrd(path: Path) -> dict[str, list[dict[str, Any]]]:
    """The rows of an .rrd file by entity, in the order of its frames. Static rows have no `frame`."""
    rows = defaultdict(list)
    for chunk in RrdReader(str(path)).store().stream().to_chunks():
        rows[chunk.entity_path] += chunk.to_record_batch().to_pylist()
    return {path: sorted(each, key=lambda row: row.get("frame", -1)) for path, each in rows.items()}


def blueprints(path: Path) -> int:
    """The number of blueprints in an .rrd file."""
    return len(RrdReader(str(path)).blueprints())
