"""A porter at work before a router that returns what it receives."""

from __future__ import annotations

import os
import socket
import ssl
import threading
from contextlib import ExitStack, suppress
from pathlib import Path

from armadico.keys.asking import RENEWAL
from armadico.keys.authority import Pair
from armadico.keys.porter import Porter
from armadico.mesh.ports import LOOPBACK

from .labs import NAMESPACE, Lab

SOON = 20.0  # s; a deadline, not an expectation


class Router:
    """What stands behind the porter: it returns what it receives."""

    def __init__(self, path: Path) -> None:
        self._line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._line.bind(str(path))
        self._line.listen()
        self.links: list[socket.socket] = []
        self.received = bytearray()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        with suppress(OSError):
            while True:
                link, _ = self._line.accept()
                self.links.append(link)
                threading.Thread(target=self._echo, args=(link,), daemon=True).start()

    def _echo(self, link: socket.socket) -> None:
        with suppress(OSError):
            while data := link.recv(65_536):
                self.received += data
                link.sendall(data)

    def close(self) -> None:
        self._line.shutdown(socket.SHUT_RDWR)
        self._line.close()
        self._thread.join()
        for link in self.links:
            link.close()


class Door:
    """A porter at work, and clients of it."""

    def __init__(self, lab: Lab, folder: Path, stack: ExitStack) -> None:
        self.lab, self.stack, self.folder = lab, stack, folder
        self.path = folder / "u.sock"
        listening = stack.enter_context(socket.create_server((LOOPBACK, 0), backlog=1024))
        self.place = listening.getsockname()
        self.porter = Porter([listening], NAMESPACE, lab.store, self.path)
        over, end = os.pipe()
        thread = threading.Thread(target=self.porter.run, args=(over,))
        thread.start()
        stack.callback(self.porter.close)
        stack.callback(thread.join)
        stack.callback(os.close, end)

    def start_router(self) -> Router:
        router = Router(self.path)
        self.stack.callback(router.close)
        return router

    def connect(
        self,
        pair: Pair | None = None,
        name: str = "goto",
        *,
        asks: bool = False,
        newest: ssl.TLSVersion = ssl.TLSVersion.MAXIMUM_SUPPORTED,
    ) -> ssl.SSLSocket:
        """Connect with a certificate, by default the one of an identity in the lab's folder.

        `asks`: as a client that asks for a new certificate. `newest`: of the client's TLS.
        """
        context = ssl.create_default_context(cafile=str(self.lab.store.authority))
        context.maximum_version = newest
        if asks:
            context.set_alpn_protocols([RENEWAL])
        if pair is not None:
            file = self.folder / "pair.pem"
            file.write_bytes(pair.private + pair.certificate)
            context.load_cert_chain(file)
        else:
            found = self.lab.store.identity(NAMESPACE, name)
            context.load_cert_chain(found.certificate, found.private)
        return self._shaken(context)

    def connect_without(self) -> ssl.SSLSocket:
        return self._shaken(ssl.create_default_context(cafile=str(self.lab.store.authority)))

    def _shaken(self, context: ssl.SSLContext) -> ssl.SSLSocket:
        line = socket.create_connection(self.place, SOON)
        self.stack.callback(line.close)
        return self.stack.enter_context(context.wrap_socket(line, server_hostname=LOOPBACK))


def works(link: ssl.SSLSocket, data: bytes = b"hello") -> bool:
    """Whether what is sent comes back; False if the link is closed."""
    try:
        link.sendall(data)
        back = b""
        while len(back) < len(data):
            if not (part := link.recv(65_536)):
                return False
            back += part
    except TimeoutError:
        raise
    except OSError:
        return False
    return back == data


def closes(link: ssl.SSLSocket) -> bool:
    """Whether a link is closed, rather than silent for long."""
    try:
        return link.recv(1) == b""
    except TimeoutError:
        return False
    except OSError:
        return True
