"""Configurations by name: those shipped with Armadico, and robot profiles of other packages.

A package's profiles lie beside the module of its kind of robot.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

from armadico.core.config_errors import ConfigNameError
from armadico.core.discovery import ROBOTS, installed
from armadico.core.errors import hint

SUFFIXES: dict[str, tuple[str, ...]] = {
    "worlds": (".map", ".yaml", ".yml"),
    "scenarios": (".toml",),
    "robots": (".toml",),
    "parameters": (".toml",),
    "missions": (".toml",),
    "policies": (".toml",),
}
"""The kinds of configuration, each a folder of `armadico.configs`, and their suffixes."""

TABLES = ("robots/sensors.toml",)
"""Files in these folders that are not configurations of the kind."""


def folder(kind: str) -> Path:
    """The folder of the shipped configurations of a kind."""
    return Path(str(files("armadico.configs"))) / kind


def _folders(kind: str) -> Iterator[Path]:
    """The folders of a kind: the shipped one, then those of other packages' robots."""
    yield folder(kind)
    for found in installed(ROBOTS).values() if kind == "robots" else ():
        if found.package != "armadico" and (path := found.path) is not None:
            yield path.parent


def names(kind: str) -> list[str]:
    """The names of the installed configurations of a kind, sorted."""
    found = [p for each in _folders(kind) for p in each.iterdir() if p.suffix in SUFFIXES[kind]]
    return sorted({path.stem for path in found if f"{kind}/{path.name}" not in TABLES})


def resource_path(kind: str, name: str) -> Path:
    """The file of an installed configuration. Raises ConfigNameError."""
    for each in _folders(kind):
        for suffix in SUFFIXES[kind]:
            path = each / (name + suffix)
            if path.is_file():
                return path
    raise ConfigNameError(_one(kind), name, names(kind))


def find(kind: str, name_or_path: str | Path) -> Path:
    """The file of a configuration: a path if it has a slash or a suffix, else a shipped name.

    Raises ConfigNameError.
    """
    path = Path(name_or_path)
    if isinstance(name_or_path, str) and not path.suffix and path.name == name_or_path:
        return resource_path(kind, name_or_path)
    if not path.is_file():
        beside = path.parent.iterdir() if path.parent.is_dir() else ()
        there = [p.name for p in beside if p.suffix in SUFFIXES[kind] and p.is_file()]
        instead = hint(path.name, there) or f"shipped {kind}: {', '.join(names(kind))}"
        what = f"{str(path)!r} is a folder" if path.is_dir() else f"no file {str(path)!r}"
        message = f"{what}; {instead}"
        raise ConfigNameError("file", path.name, there, message=message)
    return path


def counted_from(file: Path, name: str) -> str:
    """A name in a file, for `find`: a path becomes absolute, relative to the file's folder."""
    path = Path(name)
    if not path.suffix and path.name == name:
        return name  # shipped
    return str((file.parent / path.expanduser()).resolve())


def _one(kind: str) -> str:
    """The singular of a kind."""
    odd = {"parameters": "set of parameters", "policies": "policy"}
    return odd.get(kind, kind.removesuffix("s"))
