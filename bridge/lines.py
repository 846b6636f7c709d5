"""The interface of transports, and their errors, each with a remedy."""

from __future__ import annotations

import contextlib
import errno
import socket
import termios
from collections.abc import Iterator
from typing import NoReturn, Protocol

import serial

# What pyserial raises when a line breaks; TypeError if it was closed during a read.
LINE_ERRORS = (serial.SerialException, OSError, termios.error, TypeError, ValueError)
CHUNK = 4096


class TransportError(OSError):
    """A transport cannot be opened, or broke; the message has a remedy."""


class Transport(Protocol):
    """A byte stream to and from the other end."""

    @property
    def url(self) -> str:
        """Its address."""

    def open(self) -> None:
        """Connect. Raises TransportError. May be called again after `close`."""

    def read(self, timeout_s: float) -> bytes:
        """Wait for bytes; empty after `timeout_s`. Raises TransportError if the line broke."""

    def write(self, data: bytes) -> None:
        """Send all bytes. Raises TransportError if the line broke."""

    def close(self) -> None:
        """Close the line once no thread reads it any more; never fails."""


_ADVICE = {
    errno.ENOENT: "there is no such port; is the adapter plugged in? `ls /dev/ttyUSB*` shows it",
    errno.EACCES: "permission denied: `sudo usermod -a -G dialout $USER`, then log in again",
    errno.EPERM: "permission denied: `sudo usermod -a -G dialout $USER`, then log in again",
    errno.EAGAIN: "another program holds the port; end that one first",
    errno.EBUSY: "another program holds the port; end that one first",
    errno.ENOTTY: "it is not a serial port",
    errno.ECONNREFUSED: "no program listens there; is the simulator running, without a client?",
    errno.EEXIST: "a file that is not a link has that name; choose another",
}


def advice(error: BaseException) -> str:
    """The remedy for an error on opening."""
    if isinstance(error, socket.gaierror):
        return "no such host; check its name"
    if isinstance(error, TimeoutError):
        return "no answer; is the host on, and does its firewall allow the connection?"
    cause: BaseException | None = error
    while cause is not None:  # pyserial leaves some error numbers to the exception's context
        for number in (getattr(cause, "errno", None), *cause.args[:1]):
            if number in _ADVICE:
                return _ADVICE[number]
        cause = cause.__context__
    return str(error)


def not_open() -> OSError:
    """The exception for using a transport before `open`."""
    return OSError(errno.ENOTCONN, "it is not open")


@contextlib.contextmanager
def broken(where: str, remedy: str) -> Iterator[None]:
    """Convert the exceptions of a broken line into TransportError."""
    try:
        yield
    except LINE_ERRORS as error:
        raise TransportError(f"the line to {where} broke ({error}); {remedy}") from error


def ended() -> NoReturn:
    """Raise the exception for a line closed by the other end."""
    raise OSError(errno.EPIPE, "the other end closed it")
