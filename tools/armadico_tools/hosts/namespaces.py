"""Hosts as network namespaces of Linux, joined by a switch in user space.

It needs root and /dev/net/tun, but no container engine and no traffic control in the kernel.

A namespace has no name and exists as long as its thread and processes. When the creating process
ends, even by SIGKILL, the kernel removes namespaces and network devices, and every process started
in them is killed. This machine's own network is not changed.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import selectors
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final, Self, TypeVar

from armadico.launch.processes import bound, kill_trees
from armadico_tools.hosts.switch import Switch

T = TypeVar("T")

TUN: Final = Path("/dev/net/tun")
CARD: Final = "eth0"
FRAMES: Final = 64
"""Frames of one host that are read before the others have their turn."""

_CLONE_NEWNET: Final = 0x40000000
_TUNSETIFF: Final = 0x400454CA
_TAP_WITHOUT_HEADER: Final = 0x1002
_MTU: Final = 1500


def lacking() -> str | None:
    """What this machine or user lacks for namespaces, in a sentence; None if nothing."""
    if sys.platform != "linux":
        return f"network namespaces are Linux's, and this is {sys.platform}"
    if os.geteuid() != 0:
        return "making network namespaces needs root (sudo)"
    if shutil.which("ip") is None:
        return "the command ip is missing (package iproute2)"
    if not TUN.exists():
        return f"{TUN} is missing (modprobe tun; in a container: --device {TUN})"
    try:
        with Host("probe"):
            return None
    except OSError as error:
        return f"this user may not make namespaces and cards: {error}"


class Host:
    """One host: a namespace with a network device. A context manager that ends its processes."""

    def __init__(self, name: str) -> None:
        """Make the namespace and its device. Raises OSError."""
        self.name = name
        self.tap = -1
        self._thread = ThreadPoolExecutor(1, f"host-{name}")
        self._processes: list[subprocess.Popen[bytes]] = []
        try:
            self.tap = self.inside(_enter_new_namespace)
        except OSError:
            self._thread.shutdown()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def inside(self, function: Callable[..., T], *args: object, **kwargs: object) -> T:
        """Call a function in the host's network: sockets that it opens are the host's."""
        return self._thread.submit(function, *args, **kwargs).result()

    def configure(self, address: str, mac: bytes) -> None:
        """Set the device's addresses, such as `10.77.0.11/24`, and bring it up. Raises OSError."""
        self._ip(
            "link set lo up",
            f"link set {CARD} address {mac.hex(':')} mtu {_MTU} txqueuelen 1000 up",
            f"addr add {address} dev {CARD}",
        )

    def carrier(self, up: bool) -> None:
        """Set the device up or down, as `ip link set` does."""
        self._ip(f"link set {CARD} {'up' if up else 'down'}")

    def popen(self, argv: Sequence[str], **options: Any) -> subprocess.Popen[Any]:
        """Start a process on this host; it ends with the host, or with this process."""
        process: subprocess.Popen[bytes] = self.inside(
            subprocess.Popen,
            bound(argv, signal.SIGKILL),
            **{"stdin": subprocess.DEVNULL, "start_new_session": True, **options},
        )
        self._processes.append(process)
        return process

    def kill(self) -> None:
        """Kill every process of the host, like a power failure."""
        kill_trees(*self._processes)
        self._processes.clear()

    def close(self) -> None:
        """End its processes and the namespace."""
        self.kill()
        if self.tap >= 0:
            os.close(self.tap)
            self.tap = -1
        self._thread.shutdown()

    def _ip(self, *lines: str) -> None:
        done: subprocess.CompletedProcess[str] = self.inside(
            subprocess.run,
            ["ip", "-batch", "-"],
            input="\n".join(lines) + "\n",
            capture_output=True,
            text=True,
        )
        if done.returncode:
            raise OSError(f"host {self.name}: ip: {done.stderr.strip()}")


class Network:
    """Hosts on a switch, as a context manager."""

    def __init__(self, addresses: Mapping[str, str], seed: int = 0) -> None:
        """Make the hosts.

        Args:
            addresses: The IPv4 address of each host, by its name, in one network of 24 bits.
            seed: Of the random faults.
        """
        self._lock = threading.Lock()
        self._stack = ExitStack()
        cards = {bytes((2, 0, 0, 0, 0, n)): name for n, name in enumerate(addresses, 1)}
        self.switch = Switch(cards, seed)
        self.hosts: dict[str, Host] = {}
        self._bell = os.pipe()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="switch", daemon=True)
        try:
            for mac, name in cards.items():
                host = self.hosts[name] = self._stack.enter_context(Host(name))
                host.configure(f"{addresses[name]}/24", mac)
        except OSError:
            self._stack.close()
            raise
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def change(self, how: Callable[[Switch], T]) -> T:
        """Call a function with the switch while no frame passes through it."""
        with self._lock:
            result = how(self.switch)
        os.write(self._bell[1], b"\0")
        return result

    def close(self) -> None:
        """End all processes, hosts and the switch; may be called again."""
        if self._stopping:
            return
        self._stopping = True
        for host in self.hosts.values():
            host.kill()
        os.write(self._bell[1], b"\0")
        self._thread.join()
        self._stack.close()
        for end in self._bell:
            os.close(end)

    # The thread ----------------------------------------------------------------------------------

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._bell[0], selectors.EVENT_READ, None)
            for host in self.hosts.values():
                selector.register(host.tap, selectors.EVENT_READ, host)
            while not self._stopping:
                due = self.switch.next_due
                wait = None if due is None else max(due - time.monotonic(), 0.0)
                ready = [key.data for key, _ in selector.select(wait)]
                with self._lock:
                    for host in ready:
                        self._address(host)
                    self._deliver()

    def _address(self, host: Host | None) -> None:
        if host is None:
            os.read(self._bell[0], 4096)
            return
        for _ in range(FRAMES):
            try:
                frame = os.read(host.tap, _MTU + 64)
            except OSError:  # no more frames, or the device is down
                return
            self.switch.forward(host.name, frame, time.monotonic())

    def _deliver(self) -> None:
        for name, frame in self.switch.due(time.monotonic()):
            with suppress(OSError):  # the device is down, or its queue full: lost, as on a wire
                os.write(self.hosts[name].tap, frame)


def _enter_new_namespace() -> int:
    """Move this thread to a new network. Returns the other end of its device. Raises OSError."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_CLONE_NEWNET):
        number = ctypes.get_errno()
        raise OSError(number, f"unshare: {os.strerror(number)}")
    tap = os.open(TUN, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        wanted = struct.pack("16sH22x", CARD.encode(), _TAP_WITHOUT_HEADER)
        fcntl.ioctl(tap, _TUNSETIFF, wanted)
    except OSError:
        os.close(tap)
        raise
    return tap
