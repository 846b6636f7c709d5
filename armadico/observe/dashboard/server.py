"""The recording that everything is drawn into, served on loopback and kept in a file.

`rr.serve_grpc` and `rr.serve_web_viewer` would listen on every interface, so neither is used; and
the server is inside this process, since a client of a server elsewhere blocks when that one does.

**Memory.** The server keeps `SERVER_MEMORY` of messages and drops the oldest, so a viewer that
comes late sees the recent past; a scene keeps bounded collections; a native viewer keeps
`viewer.VIEWER_MEMORY`. A file that is recorded to grows, and is not kept in memory.
"""

from __future__ import annotations

import ctypes
import errno
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import rerun as rr

from armadico.config.worlds import World
from armadico.mesh.ports import LOOPBACK
from armadico.observe.dashboard.blueprint import blueprint

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


def keep(worlds: Mapping[str, World | None], record: Path) -> rr.RecordingStream:
    """A recording that only goes into a file. Raises OSError."""
    recording = _stream()
    try:
        recording.save(record, default_blueprint=blueprint(worlds))
    except RuntimeError as error:
        _abandon(recording)
        raise OSError(errno.EIO, str(error), str(record)) from None
    return recording


def finish(recording: rr.RecordingStream, record: Path) -> None:
    """Close what is kept in a file. Raises OSError if not all of it could be written."""
    if not close(recording):
        raise OSError(errno.EIO, "is not whole: what follows could not be written", str(record))


def close(recording: rr.RecordingStream) -> bool:
    """Write out what is left, and end the recording with its footer; whether all was written."""
    try:
        recording.flush(timeout_sec=CLOSE_S)
    except RuntimeError:  # nobody takes it any more: what could be written is
        _abandon(recording)
        return False
    recording.disconnect()
    return True


def _abandon(recording: rr.RecordingStream) -> None:
    """Leave a recording whose file takes no more: whoever ends it waits for that for ever.

    Nor may it be dropped, which ends it: it goes with the process.
    """
    rr.unregister_shutdown()
    for kept in (recording, recording.to_native()):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))


def _stream() -> rr.RecordingStream:
    return rr.RecordingStream(APPLICATION, batcher_config=rr.ChunkBatcherConfig(flush_tick=FLUSH_S))
