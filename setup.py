"""The wheel is pure Python; with ARMADICO_COMPILE=1 the simulated robot in it is compiled.

mypyc needs the packages as they are installed and everything that they import, so it is built
without isolation where the development dependencies are: `make compiled`.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from setuptools import setup

if TYPE_CHECKING:
    from setuptools import Extension

ROOT = Path(__file__).resolve().parent
APART = ("__init__", "server")
"""Of `bridge/simulator`: nothing to compile, and sockets, which wait rather than compute."""


def compiled() -> list[Extension]:
    """The simulated robot as extension modules, made by mypyc."""
    from mypyc.build import mypycify  # noqa: PLC0415 - not for the pure wheel

    sys.path.insert(0, str(ROOT / "tools"))
    from typecheck import link  # noqa: PLC0415

    names = sorted(path.stem for path in (ROOT / "bridge" / "simulator").glob("*.py"))
    modules = [f"armadico/bridge/simulator/{name}.py" for name in names if name not in APART]
    options = ["--config-file", str(ROOT / "pyproject.toml")]
    with tempfile.TemporaryDirectory() as folder:
        link(Path(folder))
        os.chdir(folder)  # mypyc names a module by its path from here
        try:
            made: list[Extension] = mypycify(
                [*options, *modules],
                group_name="armadico",
                target_dir=str(ROOT / "build" / "mypyc"),
            )
        finally:
            os.chdir(ROOT)
    return made


setup(ext_modules=compiled() if os.environ.get("ARMADICO_COMPILE") == "1" else [])
