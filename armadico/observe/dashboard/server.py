"""The recording that everything is drawn into, served on loopback and kept in a file.

`rr.serve_grpc` and `rr.serve_web_viewer` would listen on every interface, so neither is used; and
the server is inside this process, since a client of a server elsewhere blocks when that one does.

**Memory.** The server keeps `SERVER_MEMORY` of messages and drops the oldest, so a viewer that
comes late sees the recent past; a scene keeps bounded collections; a native viewer keeps
`viewer.VIEWER_MEMORY`. A file that is recorded to grows, and is not kept in memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

import rerun as rr

from armadico.config.worlds import World
from armadico.observe.dashboard.blueprint import blueprint
from armadico.observe.dashboard.viewer import LOOPBACK

APPLICATION: Final = "armadico"

SERVER_MEMORY: Final = "256MiB"
"""What is kept for viewers that come late."""

FLUSH_S: Final = 0.25
"""Rows are sent together this often: fewer chunks, of which a browser takes a few per image."""

CLOSE_S: Final = 2.0
"""What writing out the rest may take."""


def serve(
    worlds: Mapping[str, World | None], port: int, record: Path | None = None
) -> tuple[rr.RecordingStream, str]:
    """A recording that viewers may connect to; returns it and its address.

    Args:
        worlds: The namespaces to show, each with its world, if that is known.
        port: Where to listen; it must be free.
        record: A file to keep it in, too.
    """
    recording = _stream()
    sinks: list[rr.GrpcServerSink | rr.FileSink] = [
        rr.GrpcServerSink(bind_ip=LOOPBACK, port=port, server_memory_limit=SERVER_MEMORY)
    ]
    if record is not None:
        sinks.append(rr.FileSink(record))
    recording.set_sinks(*sinks, default_blueprint=blueprint(worlds))
    return recording, f"rerun+http://{LOOPBACK}:{port}/proxy"


def keep(
    worlds: Mapping[str, World | None], record: Path, *, graph: bool = False
) -> rr.RecordingStream:
    """A recording that only goes into a file; `graph`: that opens on the graph of agents."""
    recording = _stream()
    recording.save(record, default_blueprint=blueprint(worlds, graph=graph))
    return recording


def close(recording: rr.RecordingStream) -> None:
    """Write out what is left, within `CLOSE_S`, and end the recording with its footer."""
    with suppress(RuntimeError):  # nobody takes it any more: what could be written is
        recording.flush(timeout_sec=CLOSE_S)
    recording.disconnect()


def _stream() -> rr.RecordingStream:
    return rr.RecordingStream(APPLICATION, batcher_config=rr.ChunkBatcherConfig(flush_tick=FLUSH_S))
