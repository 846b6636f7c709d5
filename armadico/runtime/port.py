"""The interface of an open port."""

from __future__ import annotations

from typing import Protocol


class Port(Protocol):
    """An open port. All its failures are OSErrors."""

    def read(self, timeout_s: float) -> bytes:
        """Wait for bytes; none after `timeout_s`."""

    def write(self, data: bytes) -> None:
        """Send all bytes."""

    def close(self) -> None:
        """Close it; may be called again."""
