"""What a result depends on: so much stands beside each, or nobody else can come to the same."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Iterable
from functools import cache
from hashlib import sha256
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any, Final

import msgspec
from msgspec import Struct

CODE: Final = ("armadico", "armadico.agents", "armadico.bridge", "armadico.configs")
"""The packages that a run depends on; of the first, all but its commands."""


class Software(Struct, frozen=True, kw_only=True):
    """What drives: the same for every run of a process.

    `commit` ends with a + if what drives has been changed since; where it is none, as it is
    installed, `version` is what there is. `source` tells both apart: it is of all code and
    configuration that is read.
    """

    version: str
    commit: str
    source: str  # 16 hex digits
    python: str
    platform: str
    packages: dict[str, str]  # what is required, and what has brought agents, by its version


class Conditions(Struct, frozen=True, kw_only=True):
    """What one result depends on, besides its seed. Hashes are 16 hex digits."""

    mode: str  # virtual, live, or attached: others have started the agents
    namespace: str | None  # none: virtual
    robot: str | None  # the URL of a robot that was there already; none: a simulator
    scenario: dict[str, Any]  # as it was driven, with all that the command line has changed
    scenario_hash: str  # of that, but for its names, world and robot
    world_hash: str  # of its walls, rooms and doors, whatever file they are from
    profile_hash: str  # of the robot's profile
    agents: dict[str, tuple[str, ...]]  # what is set of whom; empty if others have started them
    software: Software


def digest(value: object) -> str:
    """16 hex digits of something that can be a message."""
    return sha256(msgspec.json.encode(value, order="sorted")).hexdigest()[:16]


@cache
def software() -> Software:
    """What this process drives with, as it was when it was first asked for."""
    return Software(
        version=_version("armadico"),
        commit=commit(),
        source=source_hash(),
        python=platform.python_version(),
        platform=f"{platform.system()} {platform.machine()}",
        packages=packages(_required()),
    )


def packages(names: Iterable[str]) -> dict[str, str]:
    """The versions of distributions, but for our own."""
    return {name: _version(name) for name in sorted({*names} - {"armadico", ""})}


def source_hash(*besides: Path) -> str:
    """16 hex digits of all code and configuration that a run depends on, and of files besides."""
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
    """The git commit that runs, with a + if what drives has changed since; or `none`."""
    root = Path(next(iter(import_module("armadico.agents").__path__))).resolve().parent
    try:
        if not _git(root, "ls-files", "--", "agents"):
            return "none"  # installed somewhere within a checkout of something else
        head = _git(root, "rev-parse", "--short=12", "HEAD")
        paths = ("armadico", "agents", "bridge", "configs", ":!armadico/cli")
        changed = _git(root, "status", "--porcelain", "--", *paths)
    except (OSError, subprocess.CalledProcessError):
        return "none"
    return f"{head}+" if changed else head


def _git(root: Path, *words: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(root), *words], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def _required() -> list[str]:
    """The distributions that drive: those required without an extra."""
    try:
        lines = requires("armadico") or []
    except PackageNotFoundError:
        return []
    return [
        line.partition("=")[0].rstrip("<>!~ ").partition("[")[0]
        for line in lines
        if "extra ==" not in line
    ]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
