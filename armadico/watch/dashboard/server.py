"""The dashboard's recording, served on loopback and written to a file.

`rr.serve_grpc` and `rr.serve_web_viewer` listen on all interfaces, so they are not used. The server
runs in this process, because a client of another server blocks when that server blocks.

**Memory.** The server keeps `SERVER_MEMORY` of messages and drops the oldest; a viewer that
connects later shows the recent past. Scenes have bounded collections. A native viewer keeps
`viewer.VIEWER_MEMORY`. A recorded file grows, but is not in memory.
"""

from __future__ import annotations

import ctypes
import errno
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import rerun as rr

from armadico.config.worlds import World
from armadico.mesh.ports import LOOPBACK
from armadico.watch.dashboard.blueprint import blueprint

APPLICATION: Final = "armadico"

SERVER_MEMORY: Final = "256MiB"  # messages kept for viewers that connect later

# Interval at which rows are sent together. A browser reads only a few chunks per image, so few
# large chunks are better than many small ones.
FLUSH_S: Final = 0.25

CLOSE_S: Final = 2.0  # timeout of the last flush

MARK: Final = b"RRF2FOOT"  # in the last bytes of a whole file
TAIL: Final = 64


def serve(
    worlds: Mapping[str, World | None], port: int, record: Path | None = None
) -> tuple[rr.RecordingStream, str]:
    """A recording that viewers may connect to; returns it and its address.

    It shows namespaces, each with its world, if that is known. The port must be free; a file to
    `record` gets it as well.
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
    """A recording into a file only. Raises OSError."""
    recording = _stream()
    try:
        recording.save(record, default_blueprint=blueprint(worlds))
    except RuntimeError as error:
        _abandon(recording)
        raise OSError(errno.EIO, str(error), str(record)) from None
    return recording


def finish(recording: rr.RecordingStream, record: Path) -> None:
    """Close a recording into a file. Raises OSError if it could not be written completely."""
    if not (close(recording) and _is_whole(record)):
        raise OSError(errno.EIO, "is incomplete: its end could not be written", str(record))


def _is_whole(record: Path) -> bool:
    """Whether a file has its footer: Rerun only logs it if a full disk took none."""
    with record.open("rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(-min(TAIL, file.tell()), os.SEEK_END)
        return MARK in file.read()


def close(recording: rr.RecordingStream) -> bool:
    """Flush and end the recording with its footer; False if not all was written."""
    try:
        recording.flush(timeout_sec=CLOSE_S)
    except RuntimeError:  # the sink accepts no more data
        _abandon(recording)
        return False
    recording.disconnect()
    return True


def _abandon(recording: rr.RecordingStream) -> None:
    """Keep a recording whose file accepts no more data until the process ends.

    Ending it would wait forever, and so would its destructor.
    """
    rr.unregister_shutdown()
    for kept in (recording, recording.to_native()):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(kept))


def _stream() -> rr.RecordingStream:
    return rr.RecordingStream(APPLICATION, batcher_config=rr.ChunkBatcherConfig(flush_tick=FLUSH_S))
