"""ROS 2 samples of a recording, read by Foxglove's Python reader with the schemas in the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory


def mcap_support(path: Path) -> dict[str, list[Any]]:
    """The decoded samples of each topic."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        theirs = [c.topic for c in summary.channels.values() if c.message_encoding == "cdr"]
        for _, channel, _, sample in reader.iter_decoded_messages(theirs):
            found.setdefault(channel.topic, []).append(sample)
    return found
