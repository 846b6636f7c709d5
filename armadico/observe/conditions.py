"""The conditions of a result, stored with it so that it can be reproduced."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Iterable
from functools import cache
from hashlib import sha256
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path
from typing import Final

import msgspec
from msgspec import Struct

from armadico.core.installed import version_of

# Packages that a run depends on; the commands of the first are left out.
CODE: Final = ("armadico", "armadico.agents", "armadico.bridge", "armadico.configs")


class Software(Struct, frozen=True, kw_only=True):
    """The software of a run; the same for all runs of a process.

    `commit` ends with a + if the code has uncommitted changes. It is `none` for an installed
    package; then `version` identifies it. `source` is a hash of all code and configuration read.
    """

    version: str
    commit: str
    source: str  # 16 hex digits
    python: str
    platform: str
    packages: dict[str, str]  # versions of requirements and of packages that provide agents


class Conditions(Struct, frozen=True, kw_only=True):
    """The conditions of one result, besides its seed. Hashes are 16 hex digits."""

    mode: str  # virtual, live, or attached (to running agents)
    namespace: str | None  # none: virtual
    robot: str | None  # the URL of an existing robot; none: a simulator
    scenario: dict[str, object]  # as driven, with the changes of the command line
    scenario_hash: str  # without its names, world and robot
    world_hash: str  # of its walls, rooms and doors, independent of their file
    profile_hash: str  # of the robot's profile
    agents: dict[str, tuple[str, ...]]  # parameters by agent; empty if attached
    software: Software


def digest(value: object) -> str:
    """The hash, 16 hex digits, of a value that msgspec can encode."""
    return sha256(msgspec.json.encode(value, order="sorted")).hexdigest()[:16]


@cache
def software() -> Software:
    """The software of this process, as of the first call."""
    return Software(
        version=version_of("armadico"),
        commit=commit(),
        source=source_hash(),
        python=platform.python_version(),
        platform=f"{platform.system()} {platform.machine()}",
        packages=packages(_required()),
    )


def packages(names: Iterable[str]) -> dict[str, str]:
    """The versions of distributions, without armadico's."""
    return {name: version_of(name) for name in sorted({*names} - {"armadico", ""})}


def source_hash(*besides: Path) -> str:
    """The hash, 16 hex digits, of all code and configuration of a run and of further files."""
    found = sha256()
    for package in CODE:
        root = Path(next(iter(import_module(package).__path__)))
        for path in sorted(root.rglob("*")):
            if path.suffix in {".py", ".toml", ".map"} and "cli" not in path.parts:
                found.update(f"{package}/{path.relative_to(root)}\0".encode())
                found.update(path.read_bytes())
    for path in besides:
        found.update(path.read_bytes())
    return found.hexdigest()[:16]


def commit() -> str:
    """The git commit of the code, with a + if it has uncommitted changes; or `none`."""
    root = Path(next(iter(import_module("armadico.agents").__path__))).resolve().parent
    try:
        if not _git(root, "ls-files", "--", "agents"):
            return "none"  # installed inside the checkout of another repository
        head = _git(root, "rev-parse", "--short=12", "HEAD")
        paths = ("armadico", "agents", "bridge", "configs", ":!armadico/cli")
        changed = _git(root, "status", "--porcelain", "--", *paths)
    except (OSError, subprocess.CalledProcessError):
        return "none"
    return f"{head}+" if changed else head


def _git(root: Path, *words: str) -> str:
    # Without optional locks: `git status` writes the index, and leaves its lock behind if it is
    # killed, such as by a limit on file sizes.
    command = ["git", "--no-optional-locks", "-C", str(root), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def _required() -> list[str]:
    """The distributions required without an extra."""
    try:
        lines = requires("armadico") or []
    except PackageNotFoundError:
        return []
    return [
        line.partition("=")[0].rstrip("<>!~ ").partition("[")[0]
        for line in lines
        if "extra ==" not in line
    ]
