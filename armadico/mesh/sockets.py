"""The Unix sockets of robots' routers on one computer.

They are in a folder that only this user may write to, named after the robots' namespaces. A router
holds a lock beside its socket, so a namespace has one router, and the socket of a killed process
does not block the next one.
"""

from __future__ import annotations

import fcntl
import os
import re
import signal
import socket
import stat
import struct
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NamedTuple

from armadico.mesh.topology import TopologyError, place_of

RUNTIME_VARIABLE: Final = "XDG_RUNTIME_DIR"

LONGEST: Final = 100  # bytes of a path: the system allows 107, and the lock's name has five more

STOP_SIGNAL: Final = signal.SIGUSR1
"""Stops the robot whose agent's process receives it."""

IDENTITY: Final = ".guard-pid"
"""Suffix of the file with the `identity` of a robot's guard, beside its socket."""

HELD: Final = ".guard-stop"
"""Suffix of the file that tells the next guard of a stop that no robot agent has latched."""

KEYS: Final = ".keys"
"""Suffix of the file with the folder of keys of a robot's router, beside its socket."""

REOPENS: Final = 10
"""How often a router's lock is looked for, `AGAIN_S` apart: it is free while the router reopens."""

LATCHES_S: Final = 0.3
"""How long `stop` waits for the robot agent."""

AGAIN_S: Final = 0.02
"""How often it asks."""

_ANSWER_S: Final = 0.3

_SLASH: Final = "%2f"
_SHORTENED: Final = f"[0-9a-f]{{10}}{_SLASH}[0-9a-f]{{10}}"  # as `_short` makes it


def folder() -> Path:
    """Return the user's folder of sockets. Raises TopologyError if it cannot be used."""
    base = os.environ.get(RUNTIME_VARIABLE)
    path = Path(base) / "armadico" if base and os.access(base, os.W_OK) else _default()
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.stat()
    except OSError as error:
        raise TopologyError(
            f"cannot make {path} for sockets: {error.strerror}; set {RUNTIME_VARIABLE} to a folder"
            " that you may write to"
        ) from None
    if {found.st_uid, path.lstat().st_uid} != {os.getuid()}:  # of a link, too
        raise TopologyError(f"{path} belongs to another user; set {RUNTIME_VARIABLE}")
    if stat.S_IMODE(found.st_mode) & 0o022:
        raise TopologyError(
            f"other users can write to {path}; expected mode 0700: chmod 700 {path}"
        )
    return path


def _default() -> Path:
    """Return the folder of sockets without a runtime folder.

    It is beside temporary files. There another user can make one of its name before or after this
    user's processes start, so the second folder, in the home, counts while a process uses it.
    """
    import tempfile  # slow, and `armadico stop` is urgent

    path = Path(tempfile.gettempdir()) / f"armadico-{os.getuid()}.run"
    try:
        home = Path.home() / ".armadico.run"
    except RuntimeError:  # a user without an entry in the list of users
        return path
    taken = path.is_symlink() or (path.exists() and path.lstat().st_uid != os.getuid())
    return home if taken or (_in_use(home) and not _in_use(path)) else path


def _in_use(path: Path) -> bool:
    """Return whether a process has its lock in a folder of sockets."""
    locks = (*path.glob("*.sock.lock"), *path.glob("*@*.json"))
    return any(map(is_held, locks))


def elsewhere(namespace: str) -> dict[Path, int]:
    """Return other folders in which a process of this user runs this robot, and its pid.

    They are those of processes that were started with another runtime folder, or whose folder was
    deleted.
    """
    names = {f"{name}.sock.lock" for name in (stem(namespace), _short(namespace))}
    share, found, own = f"{stem(namespace)}@", dict[Path, int](), _own()
    for pid in {pid for pid, _ in _lockers()}:
        for path in _open_files(pid):
            is_share = path.name.startswith(share) and path.suffix == ".json"
            if (path.name in names or is_share) and path.parent != own:
                found[path.parent] = pid
    return found


def shown(found: Mapping[Path, int]) -> str:
    """Return what to do about a robot that runs in other folders, for people."""
    path, pid = next(iter(found.items()))
    more = f" ({len(found) - 1} more like it)" if len(found) > 1 else ""
    base = f"set {RUNTIME_VARIABLE}={path.parent}"
    todo = base if path.name == "armadico" else f"unset {RUNTIME_VARIABLE}"
    return f"One runs with its sockets in {path} (process {pid}){more}: {todo} to reach it"


def _own() -> Path | None:
    try:
        return folder().resolve()
    except TopologyError:
        return None


def _lockers() -> list[tuple[int, int]]:
    """Return the pid and the inode of each lock by flock, as far as is known."""
    try:
        rows = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
    except OSError:
        return []
    return [(int(row[4]), int(row[5].rpartition(":")[2])) for row in rows if row[1] == "FLOCK"]


def _open_files(pid: int) -> Iterator[Path]:
    """Yield the files that a process of this user has open, deleted ones, too."""
    with suppress(OSError):  # no such process, or another user's
        if Path(f"/proc/{pid}").stat().st_uid != os.getuid():
            return
        for number in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):  # closed meanwhile
                yield Path(str(number.readlink()).removesuffix(" (deleted)"))


def robots_here() -> list[str]:
    """Return the namespaces of robots whose router or share runs on this computer.

    One whose name is too long for a socket is known by its share alone.
    """
    where = folder()
    routers = [p.name.removesuffix(".sock.lock") for p in where.glob("*.sock.lock") if is_held(p)]
    shares = [p.name.rpartition("@")[0] for p in where.glob("*@*.json") if is_held(p)]
    names = {name for name in routers if not re.fullmatch(_SHORTENED, name)} | {*shares}
    return sorted(re.sub("%([0-9a-f]{2})", lambda c: chr(int(c[1], 16)), name) for name in names)


def socket_of(namespace: str) -> Path:
    """Return the path of a router's socket. Raises TopologyError if it is too long."""
    where = folder()
    for name in (stem(namespace), _short(namespace)):
        path = where / f"{name}.sock"
        if len(os.fsencode(path)) <= LONGEST:
            return path
    raise TopologyError(
        f"{path} is too long for a socket: {len(os.fsencode(path))} bytes, at most {LONGEST};"
        f" set {RUNTIME_VARIABLE} to a shorter folder"
    )


def guard_of(namespace: str) -> Path:
    """Return the path of the socket for stops of a robot's guard (`armadico.runtime.guard`).

    Raises TopologyError if it is too long.
    """
    return socket_of(namespace).with_suffix(".guard")


def keys_here(namespace: str) -> Path | None:
    """Return the folder of keys of the robot whose router is on this computer.

    None: there is none now, or it is open. The router writes it (`note_keys`), for commands that
    read no host table.
    """
    try:
        path = socket_of(namespace)
        text = path.with_suffix(KEYS).read_text(encoding="utf-8")
    except (OSError, TopologyError):
        return None
    for _ in range(REOPENS):
        if is_held(lock_of(path)):
            return Path(text)
        time.sleep(AGAIN_S)
    return None  # the file is left over


def note_keys(namespace: str, folder: str) -> None:
    """Write the folder of keys beside a router's socket, for `keys_here`; "": it is open."""
    path = socket_of(namespace).with_suffix(KEYS)
    path.unlink(missing_ok=True)
    if folder:
        path.write_text(folder, encoding="utf-8")


class Guard(NamedTuple):
    """What a guard answers: `passes`, `braked` or `holds` (`armadico.runtime.guard`)."""

    word: str
    pid: int
    agent: int  # the pid of its robot agent

    @property
    def did(self) -> str:
        """What it did for the robot, for people."""
        return _DID[self.word].format(f"the guard of its line (process {self.pid})")


_DID: Final = {
    "passes": "{} has nothing to brake",
    "braked": "{} has braked the robot",
    "holds": "{} has stopped the robot",
}


def guard_now(namespace: str, within: float = _ANSWER_S) -> Guard | None:
    """Ask the guard of a robot on this computer.

    None: there is none, or it does not answer within so long, s.
    """
    with _guard_line(namespace) as line:
        if line is not None:
            line.settimeout(within)
        return _answer(line, b"?")


@contextmanager
def _guard_line(namespace: str) -> Iterator[socket.socket | None]:
    """A socket to a robot's guard, which takes the guard's answers alone; None without one."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.settimeout(_ANSWER_S)
        try:
            line.bind("")  # Linux chooses a name
            line.connect(str(guard_of(namespace)))
        except OSError:
            yield None
        else:
            yield line


def _answer(line: socket.socket | None, datagram: bytes = b"") -> Guard | None:
    """Send a guard a datagram, if it is not empty, and return its answer."""
    if line is None:
        return None
    try:
        if datagram:
            line.send(datagram, socket.MSG_DONTWAIT)
        word, pid, agent = line.recv(64).decode().split()
    except OSError:
        return None
    return Guard(word, int(pid), int(agent))


def stem(name: str) -> str:
    """Return a name escaped for a file's name; different names stay different."""
    return re.sub(r"[^A-Za-z0-9_.-]", lambda found: f"%{ord(found[0]):02x}", name)


def endpoint(path: Path) -> str:
    """Return Zenoh's endpoint of a socket."""
    return f"unixsock-stream/{path}"


def holder(path: Path) -> int | None:
    """Return the pid of the process that listens on a socket; None if none does."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(_ANSWER_S)
            probe.connect(str(path))
            peer = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    except OSError:
        return None
    pid: int = struct.unpack("3i", peer)[0]
    return pid


def lock_of(path: Path) -> Path:
    """Return the path of a socket's lock."""
    return path.with_name(f"{path.name}.lock")


def share_of(namespace: str, host: str) -> Path:
    """Return the path of the file that `armadico up` locks for a host's share of a society."""
    return folder() / f"{stem(namespace)}@{stem(host)}.json"


def shares_of(namespace: str) -> list[Path]:
    """Return such files on this computer, locked or not."""
    return sorted(folder().glob(f"{stem(namespace)}@*.json"))


def starting(namespace: str, within: float) -> bool:
    """Return whether a share of a society was started here less than so long ago, s."""
    with suppress(OSError, TopologyError):  # it ends, or there is no folder
        now = time.time()
        return any(is_held(p) and now - p.stat().st_mtime < within for p in shares_of(namespace))
    return False


def owner(lock: Path) -> int | None:
    """Return the pid of this user's process that has a file locked; None if none has.

    Unlike `holder` it needs nothing of that process, however busy it is.
    """
    try:
        inode = lock.stat().st_ino
    except OSError:
        return None
    return next((pid for pid, at in _lockers() if at == inode and _has_open(pid, lock)), None)


def _has_open(pid: int, path: Path) -> bool:
    """Return whether a process has a file open; another file system may have its inode, too."""
    with suppress(OSError):  # no such process, or another user's
        for number in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):  # closed meanwhile
                if number.samefile(path):
                    return True
    return False


class Stopped(NamedTuple):
    """Which processes of this computer have the order to stop a robot."""

    # The robot agent's, or that of `armadico up`, which passes it on; None without one: it is not
    # there, not this user's, or the signal would end it.
    pid: int | None
    guard: Guard | None = None  # the guard's answer; None without one
    latched: bool = False  # the robot agent has latched the stop, by what it told its guard


def stop(namespace: str, within: float = LATCHES_S) -> Stopped:
    """Order a robot to stop, without a connection to it.

    On the robot's computer its guard and its robot agent get the order, on another one `armadico
    up`, which is on the mesh already. Waits at most so long, s, until the robot agent has it.
    """
    with _guard_line(namespace) as line:
        if line is not None:
            with suppress(OSError):  # it has stops enough to read
                line.send(b"stop", socket.MSG_DONTWAIT)
        locks = (lock_of(socket_of(namespace)), *shares_of(namespace))
        pid = next((pid for lock in locks if (pid := _signal(owner(lock))) is not None), None)
        end = time.monotonic() + within
        guard = found = _answer(line)
        while found is not None and found.word == "holds" and time.monotonic() < end:
            time.sleep(AGAIN_S)
            found = _answer(line, b"?")
    return Stopped(pid, guard, latched=found is not None and found.word != "holds")


def _signal(pid: int | None) -> int | None:
    """Send a process the signal to stop; return its pid, None if it does not know the signal."""
    if pid is None:
        return None
    try:
        status = Path(f"/proc/{pid}/status").read_text()
        caught = int(status.partition("SigCgt:")[2].split()[0], 16)
        if caught >> (STOP_SIGNAL - 1) & 1 == 0:
            return None
        os.kill(pid, STOP_SIGNAL)
    except (OSError, IndexError):
        return None
    return pid


def clear(namespace: str) -> None:
    """Remove the files of a robot's router and guard here, unless they belong to a process."""
    path, guard = socket_of(namespace), guard_of(namespace)
    if not is_held(lock_of(path)) and holder(path) is None:
        path.unlink(missing_ok=True)
        lock_of(path).unlink(missing_ok=True)
        path.with_suffix(KEYS).unlink(missing_ok=True)
    with _guard_line(namespace) as line:
        if line is None:
            for each in (guard, guard.with_suffix(IDENTITY), guard.with_suffix(HELD)):
                each.unlink(missing_ok=True)


def identity(pid: int) -> str:
    """Return a process's pid and start time, which `deploy/bin/armadico` reads.

    No later process has the same two. Without /proc it is the pid, which nothing reads.
    """
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return str(pid)
    return f"{pid} {fields[19]}"


def is_held(path: Path) -> bool:
    """Return whether a live process has a file locked."""
    try:
        with path.open() as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        pass
    return False


def is_deleted(path: Path) -> bool:
    """Return whether a router listens on a deleted socket, to which no process can connect."""
    return not path.exists() and is_held(lock_of(path))


def answers(endpoint: str, within: float) -> bool:
    """Return whether a router's port accepts connections, within a timeout in s.

    It is assumed of protocols that are not over TCP.
    """
    if endpoint.partition("/")[0] not in ("tcp", "tls", "ws"):
        return True
    try:
        socket.create_connection(place_of(endpoint), within).close()
    except OSError:
        return False
    return True


# Robots that share keys, on one computer ----------------------------------------------------------


def peers_here(namespace: str) -> tuple[str, ...]:
    """Return the endpoints of such robots' routers on this computer, the robot's own too."""
    return tuple(endpoint(path) for path in peer_sockets(namespace) if holder(path) is not None)


def peer_sockets(namespace: str) -> list[Path]:
    """Return the sockets of the robots beside this one, `lab/...`; in use or not."""
    beside, slash, _ = namespace.rpartition("/")
    begins = stem(beside + slash), _short(namespace).rpartition(_SLASH)[0] + _SLASH

    def is_of_it(name: str) -> bool:
        return any(name.startswith(b) and "%" not in name.removeprefix(b) for b in begins)

    return [path for path in sorted(folder().glob("*.sock")) if is_of_it(path.name)]


def _short(namespace: str) -> str:
    """Return a namespace as a short name, whose first part is that of the robots beside it."""
    import hashlib  # slow

    beside, _, robot = namespace.rpartition("/")
    parts = (part.encode(errors="surrogatepass") for part in (beside, robot))  # any that is typed
    return _SLASH.join(hashlib.sha256(part).hexdigest()[:10] for part in parts)
