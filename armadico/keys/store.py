"""The folder of keys of one computer: its files, and the modes that they must have.

    FOLDER/                              0700
      authority.pem                      the authority's certificate: on every computer
      authority.key                0600  its private key: only where certificates are issued
      passwords.key                0600  the secret of all passwords: there, and on the robot's
      members.json                       every identity: there, and on the robot's
      <namespace>/<name>/                one identity of this computer
        certificate.pem
        agents                             the agents of its process, if it is one of agents
        private.key                0600  Ed25519, for TLS and for signatures
        password                   0600  for the robot's socket, and asked for on TLS, too

This module imports nothing heavy, because each process that joins reads the folder.
"""

from __future__ import annotations

import fcntl
import json
import os
import stat
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote

from armadico.core.config_errors import ConfigError
from armadico.mesh.door import CLIENT, LAUNCHER, PERSON, ROBOT, name_of
from armadico.mesh.sockets import stem
from armadico.mesh.topology import default_namespace

AUTHORITY: Final = "authority.pem"
AUTHORITY_KEY: Final = "authority.key"
SECRET: Final = "passwords.key"
MEMBERS: Final = "members.json"
AGENTS: Final = "agents"
CERTIFICATE: Final = "certificate.pem"
PRIVATE: Final = "private.key"
PASSWORD: Final = "password"
USERS: Final = "users"  # a router's dictionary, written when it starts

BACKDATED_S: Final = 3600.0
"""A certificate is valid from so long before it was issued, s: clocks differ."""


@dataclass(frozen=True)
class Issue:
    """One issue of an identity: the keys that one archive has of it."""

    number: int  # counts the issues of the identity (`user_of`)
    # What has these keys: a host, or the archive of a person or an agent. Older folders have one
    # issue for all hosts.
    holders: tuple[str, ...] = ()
    given: str = ""  # when keys of it were last made, as ISO 8601; "" before the first
    revoked: str = ""  # when it was revoked; "" if it is not


@dataclass(frozen=True)
class Member:
    """An identity, as the authority and the robot's computer list it."""

    name: str  # `<namespace>/<name>`
    kind: str  # agent, robot, person, page, mcp, ros2, viewer, launcher or simulator
    agents: tuple[str, ...] = ()  # the agents of its process
    # What was, or will be, issued of it. Each issue has its own certificate, password and user
    # name, so it can be revoked alone. The robot has one.
    issues: tuple[Issue, ...] = ()

    @property
    def namespace(self) -> str:
        return self.name.rpartition("/")[0]

    @property
    def users(self) -> dict[str, Issue]:
        """The issues that are not revoked, by user name."""
        return {user_of(self.name, each.number): each for each in self.issues if not each.revoked}

    @property
    def void(self) -> set[str]:
        """The user names that count no more, also of issues that are not listed any more."""
        numbers = range(max((each.number for each in self.issues), default=-1) + 1)
        return {user_of(self.name, number) for number in numbers} - self.users.keys()

    def held(self, by: str) -> Member:
        """The same with an issue for a holder, which may exist."""
        own = [each for each in self.users.values() if each.holders == (by,)]
        if self.kind == ROBOT and self.issues:
            first, *_ = self.issues
            holders = tuple(dict.fromkeys((*first.holders, by)))
            return replace(self, issues=(replace(first, holders=holders),))
        if own:
            return self
        number = max((each.number for each in self.issues), default=-1) + 1
        return replace(self, issues=(*self.issues, Issue(number, (by,))))

    def user(self, holder: str) -> str:
        """The user name of a holder's newest issue. Raises StopIteration without one."""
        of = (user for user, each in reversed(self.users.items()) if holder in each.holders)
        return next(of)

    def with_issue(self, issue: Issue) -> Member:
        """The same with an issue in place of the one with its number."""
        issues = (issue if each.number == issue.number else each for each in self.issues)
        return replace(self, issues=tuple(issues))


def user_of(name: str, number: int) -> str:
    """Return the user name of an issue, which is the common name of its certificate."""
    return f"{name}@{number}" if number else name


def name_in(user: str) -> str:
    """Return the identity of a user name."""
    return user.partition("@")[0]


ANEW: Final = "`armadico keys host`, `agent` or `person` makes a new key"


def why_void(user: str, members: Mapping[str, Member]) -> str:
    """Return why the keys of a user name do not count, by the list of identities; "" if they do."""
    member = members.get(name_in(user))
    if member is None:
        return f"{user} is not in the list of identities: {ANEW}"
    if user in member.users:
        return ""
    for each in member.issues:
        if user_of(member.name, each.number) == user:
            return f"{user} was revoked {each.revoked}: {ANEW}"
    return f"{user} is from before {member.name} was revoked and made anew: {ANEW}"


@dataclass(frozen=True)
class Identity:
    """The files of one identity of this computer."""

    name: str
    folder: Path

    @property
    def namespace(self) -> str:
        return self.name.rpartition("/")[0]

    @property
    def last(self) -> str:
        """Its name without the namespace."""
        return self.name.rpartition("/")[2]

    @property
    def certificate(self) -> Path:
        return self.folder / CERTIFICATE

    @property
    def private(self) -> Path:
        return self.folder / PRIVATE

    @property
    def password(self) -> Path:
        return self.folder / PASSWORD

    def read_password(self) -> str:
        """Return the password; that of a damaged file is a wrong one. Raises OSError."""
        return self.password.read_text(encoding="utf-8", errors="replace")

    @property
    def users(self) -> Path:
        """The dictionary of a robot's router, which it writes when it starts."""
        return self.folder / USERS

    @property
    def agents(self) -> tuple[str, ...]:
        """The agents of its process; empty if it is none of agents."""
        try:
            return tuple((self.folder / AGENTS).read_text(encoding="utf-8").split())
        except OSError:
            return ()


@dataclass(frozen=True)
class Store:
    """The keys of one computer. Methods raise ConfigError with the file and what to do."""

    folder: Path

    @property
    def authority(self) -> Path:
        return self.folder / AUTHORITY

    @property
    def authority_key(self) -> Path:
        return self.folder / AUTHORITY_KEY

    @property
    def issues(self) -> bool:
        """Whether certificates are issued here."""
        return self.authority_key.exists()

    # Identities ----------------------------------------------------------------------------------

    def identity(self, namespace: str, name: str) -> Identity:
        """An identity's files, which need not exist."""
        return Identity(f"{namespace}/{name}", self.folder / stem(namespace) / stem(name))

    def of(self, name: str) -> Identity:
        """The same, of `<namespace>/<name>`."""
        namespace, _, last = name.rpartition("/")
        return self.identity(namespace, last)

    def identities(self) -> Iterator[Identity]:
        """The identities whose keys are here."""
        for path in sorted(self.folder.glob(f"*/*/{CERTIFICATE}")):
            yield Identity("/".join(map(unquote, path.parts[-3:-1])), path.parent)

    def of_agents(self, namespace: str, agents: Sequence[str]) -> str:
        """The name of the identity of a process: its agents', or that of a group with them."""
        name = name_of(agents)
        if not self.identity(namespace, name).certificate.is_file():
            groups = [i for i in self.identities() if i.namespace == namespace]
            groups = [group for group in groups if {*agents} <= {*group.agents}]
            if groups:
                return min(groups, key=lambda group: len(group.agents)).last
        return name

    def checked(self, namespace: str, name: str) -> Identity:
        """An identity whose files exist, and cannot be read by other users."""
        self.check()
        found = self.identity(namespace, name)
        for file in (found.certificate, found.private, found.password):
            if not file.is_file():
                known = ", ".join(identity.name for identity in self.identities()) or "none"
                raise ConfigError(
                    f"{self.folder} has no key of {found.name} (known: {known});"
                    f" {_how(namespace, name)} makes one"
                    " on the computer that has the authority's key"
                )
        check_private(found.private)
        check_private(found.password)
        return found

    def check(self) -> None:
        """Raise ConfigError if there are no keys, or other users can read the folder."""
        if not self.authority.is_file():
            raise ConfigError(
                f"no keys in {self.folder}: run `armadico keys init` on one computer, and then"
                " `armadico keys host` there for each other computer"
            )
        check_private(self.folder)

    def save(self, member: Member, certificate: bytes, private: bytes, password: str) -> Identity:
        """Write an identity; without a private key that of before stays."""
        found = self.of(member.name)
        for folder in (self.folder, found.folder.parent, found.folder):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if private:
            write_private(found.private, private)
        if member.agents:
            write_private(found.folder / AGENTS, "\n".join(member.agents).encode())
        write_private(found.password, password.encode())
        write_private(found.certificate, certificate)
        return found

    # What the authority's computer and the robot's have ------------------------------------------

    def members(self) -> dict[str, Member]:
        """Every identity by name."""
        path = self.folder / MEMBERS
        if not path.exists():
            raise ConfigError(
                f"{path} is missing: it has every identity, and is where the authority's key is,"
                " and in the archive for the robot's computer"
            )
        try:
            rows = json.loads(path.read_text(encoding="utf-8"))
            found = [_member(row) for row in rows]
        except (ValueError, TypeError) as error:
            raise ConfigError(
                f"cannot be read: {error}; restore it from a copy, such as the archive for the"
                " robot's computer, and revoke again what was revoked since; without it no identity"
                " is admitted or revoked",
                path,
            ) from None
        return {member.name: member for member in found}

    def void(self, namespace: str) -> frozenset[str]:
        """The user names of a namespace that count no more. Raises ConfigError without the list."""
        own = [each for each in self.members().values() if each.namespace == namespace]
        return frozenset(user for member in own for user in member.void)

    def members_here(self) -> dict[str, Member]:
        """Every identity by name where the list is; none on other computers.

        Raises ConfigError if it is missing beside the secret of the passwords, which needs it.
        """
        lists = any((self.folder / name).exists() for name in (MEMBERS, SECRET, AUTHORITY_KEY))
        return self.members() if lists else {}

    @contextmanager
    def changing(self) -> Iterator[None]:
        """Keep other commands from changing the list of identities and the keys meanwhile.

        Otherwise one that makes keys could write the list of before a revocation, and two could
        leave the private key of one with the certificate of the other.
        """
        folder = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
            yield
        finally:
            os.close(folder)

    def save_members(self, members: Mapping[str, Member]) -> None:
        rows = [asdict(member) for _, member in sorted(members.items())]
        write_private(self.folder / MEMBERS, json.dumps(rows, indent=1).encode())

    def user_with(self, password: str, member: Member) -> str:
        """Return the user name of the issue that has a password; "" if none that counts has it."""
        return next((user for user in member.users if self.password(user) == password), "")

    def password(self, user: str) -> str:
        """The password of an issue, by its user name."""
        import hmac  # slow, and only where passwords are made

        path = self.folder / SECRET
        if not path.exists():
            raise ConfigError(f"{path} is missing: it is in the archive for the robot's computer")
        check_private(path)
        name, _, number = user.partition("@")
        text = f"{name}\n{number or 0}".encode()
        return hmac.new(path.read_bytes(), text, "sha256").hexdigest()

    def users(self, namespace: str) -> Path:
        """Write the dictionary of a robot's router, and return its path.

        It has all identities of the namespace and the robots beside it, without revoked issues.
        """
        lines = [
            f"{user}:{self.password(user)}"
            for member in self.members().values()
            if admits(member, namespace)
            for user in member.users
        ]
        path = self.identity(namespace, ROBOT).users
        write_private(path, "\n".join(lines).encode())
        return path

    def copy(self, other: Store, *, robots: bool) -> None:
        """Write what every computer needs, and the robot's; never the authority's key."""
        names = (AUTHORITY, SECRET, MEMBERS) if robots else (AUTHORITY,)
        for name in names:
            write_private(self.folder / name, (other.folder / name).read_bytes())

    def begin(self, certificate: bytes, private: bytes) -> None:
        """Write a new authority and the secret of all passwords.

        Its certificate is the last file: without it, all is begun again after an interruption.
        """
        import secrets

        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        check_private(self.folder)
        with self.changing():
            write_private(self.authority_key, private)
            write_private(self.folder / SECRET, secrets.token_bytes(32))
            self.save_members({})
            write_private(self.authority, certificate)


def admits(member: Member, namespace: str) -> bool:
    """Return whether an identity is of a robot's society, or a robot beside it."""
    beside, its = namespace.rpartition("/")[0], member.namespace
    return its == namespace or (member.kind == ROBOT and its.rpartition("/")[0] == beside)


def _member(row: dict[str, Any]) -> Member:
    """A member of a row of the file. In older files all hosts have the same issue."""
    if "issues" not in row:
        only = {key: row.pop(key) for key in ("hosts", "issue", "revoked") if key in row}
        row["issues"] = [
            {
                "number": only.get("issue", 0),
                "holders": only.get("hosts", ()),
                "revoked": only.get("revoked", ""),
            }
        ]
    issues = (Issue(**each | {"holders": tuple(each["holders"])}) for each in row["issues"])
    return Member(**row | {"agents": tuple(row.get("agents", ())), "issues": tuple(issues)})


def check_private(path: Path) -> None:
    """Raise ConfigError if a file cannot be read, or others than its user can read it."""
    try:
        found = path.stat()
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", path) from None
    mode = 0o700 if stat.S_ISDIR(found.st_mode) else 0o600
    if stat.S_IMODE(found.st_mode) & 0o077:
        raise ConfigError(
            f"other users can read it (mode {stat.S_IMODE(found.st_mode):04o}); expected"
            f" {mode:04o}: chmod {mode:o} {path}",
            path,
        )


def _how(namespace: str, name: str) -> str:
    """The command that makes the key of an identity."""
    where = "" if namespace == default_namespace() else f" --namespace {namespace}"
    for kind, verb in ((PERSON, "person"), (LAUNCHER, "host"), (CLIENT, "client")):
        if name.startswith(kind):
            return f"`armadico keys {verb} {name.removeprefix(kind)}{where}`"
    return f"`armadico keys agent {name.replace('+', ' ')}{where}`"


def write_private(path: Path, data: bytes) -> None:
    """Replace a file, which only its user can read from the first byte on."""
    new = path.with_name(f".{path.name}.{threading.get_native_id()}")  # of this writer alone
    new.unlink(missing_ok=True)
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with open(descriptor, "wb") as file:  # noqa: PTH123 - a path has no mode
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)


def stamp(path: Path) -> tuple[int, int, int] | None:
    """Return what differs once a file is replaced or written to; None without a file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size
