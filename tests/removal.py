"""Take packages out of a copy of the tree: what remains must install, drive and pass its tests.

    python -m tests.removal                 all of them, and all but one, for each; the core alone
    python -m tests.removal all only-slam   without any of them; without any but SLAM
    python -m tests.removal slam            without SLAM: the tests of all others, minutes

A package is its folder, its tests and its entry points, and nothing else is touched. The tests of
the core and the robot run with all of them taken out at once: they cannot tell one missing package
from another. The tests of a package run with all others taken out: so each runs once without each
other one, where taking out one after the other runs all tests nine times. `tests/whole` and the
laboratory stand above all packages and are taken out, too.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from tests.programs import kill_trees

ROOT: Final = Path(__file__).parents[1]

FOLDERS: Final = {
    "slam": "agents/slam",
    "missions": "agents/missions",
    "fleet": "agents/fleet",
    "rivals": "agents/rivals",
    "ros2": "bridge/ros2",
    "watch": "armadico/watch",
    "contracts": "armadico/contracts",
    "keys": "armadico/keys",
    "rehearsal": "armadico/rehearsal",
}
"""The packages that may go, and their folders."""

ONLY: Final = "only-"

CORE: Final = ("core", "mobile", "mesh", "runtime", "testing")
"""The folders of `armadico` that are the core."""

ALONE: Final = """
from armadico.testing import RobotOwner, Society, bidder

society = Society(RobotOwner, bidder("calm", 0.4), bidder("keen", 0.6))
society.run(3.0)
assert society.holders() == ["keen"], society.holders()
"""
"""Two agents of one's own that compete on the virtual mesh, of nothing but the core."""

SOON_S: Final = 300.0


def main(words: Sequence[str] | None = None) -> int:
    """Take out what is named; return 0 if everything else works."""
    parser = argparse.ArgumentParser(prog="python -m tests.removal", description=__doc__)
    usual = ("core", "all", *(f"{ONLY}{name}" for name in FOLDERS))
    known = (*usual, *FOLDERS)
    parser.add_argument("what", nargs="*", metavar="WHAT", help=f"of {', '.join(known)}")
    parser.add_argument("-n", "--workers", default="4", help="of pytest (default: 4)")
    args = parser.parse_args(words)
    if wrong := {*args.what} - {*known}:
        parser.error(f"no {min(wrong)!r}; known: {', '.join(known)}")
    failed = [what for what in args.what or usual if not _try(what, args)]
    print(f"failed: {', '.join(failed)}" if failed else "every package can be taken out")
    return bool(failed)


def _try(what: str, args: argparse.Namespace) -> bool:
    with tempfile.TemporaryDirectory(prefix="armadico-") as folder:
        copy = Path(folder, "armadico")
        _copy(copy)
        gone = _gone(what)
        for package in gone:
            remove(copy, package)
        shutil.rmtree(copy / "tests" / "whole")
        shutil.rmtree(copy / "tests" / "laboratory")
        if what == "core":
            _leave_the_core(copy)
        home = Path(folder, "home")
        home.mkdir(mode=0o700)
        env = {k: v for k, v in os.environ.items() if not k.startswith("ARMADICO_")}
        env["XDG_RUNTIME_DIR"] = str(home)
        python = _installed(copy, Path(folder, "venv"))
        steps = _core_steps(python) if what == "core" else _steps(python, gone, args.workers)
        for name, command, within in steps:
            if not _step(f"{_label(what)}: {name}", command, copy, env, within):
                return False
        return what not in (*FOLDERS, "all") or _live(python, copy, env, what)


def _gone(what: str) -> tuple[str, ...]:
    if what in FOLDERS:
        return (what,)
    return tuple(name for name in FOLDERS if what != f"{ONLY}{name}")


def _label(what: str) -> str:
    return f"without {what}" if what in (*FOLDERS, "all") else what.replace("-", " ")


def _copy(copy: Path) -> None:
    """The files of the working tree that git does not ignore."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    for name in filter(None, listed.stdout.split("\0")):
        source, target = ROOT / name, copy / name
        if not (source.is_symlink() or source.is_file()):
            continue  # deleted in the working tree
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(source, target, follow_symlinks=False)


def remove(copy: Path, package: str) -> None:
    """Take a package out: its folder, its tests, its entry points."""
    folder = FOLDERS[package]
    shutil.rmtree(copy / folder)
    shutil.rmtree(copy / "tests" / package)
    module = folder if folder.startswith("armadico/") else f"armadico/{folder}"
    point = re.compile(rf'^\S+ = "{re.escape(module.replace("/", "."))}[.:"].*\n', re.MULTILINE)
    path = copy / "pyproject.toml"
    path.write_text(point.sub("", path.read_text(encoding="utf-8")), encoding="utf-8")


def _leave_the_core(copy: Path) -> None:
    for name in ("agents", "bridge"):
        (copy / "armadico" / name).unlink()
        shutil.rmtree(copy / name)
    for path in (copy / "armadico").iterdir():
        if path.is_dir() and not path.is_symlink() and path.name not in CORE:
            shutil.rmtree(path)
    path = copy / "pyproject.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(
        re.sub(r'^\S+ = "armadico\.(?:agents|bridge|cli)[.:].*\n', "", text, flags=re.M)
    )


def _installed(copy: Path, venv: Path) -> Path:
    """The Python of an environment with the copy, above the packages of this one."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(venv)], check=True)
    packages = next(venv.glob("lib/python*/site-packages"))
    (packages / "zz_below.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
    # The laboratory below is another tree's: a distribution without entry points hides it.
    hidden = packages / "armadico_tools-0.dist-info"
    hidden.mkdir()
    (hidden / "METADATA").write_text("Metadata-Version: 2.1\nName: armadico-tools\nVersion: 0\n")
    python = venv / "bin" / "python"
    command = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run(
        [str(python), *command, "--disable-pip-version-check", "-e", str(copy)],
        check=True,
        stderr=subprocess.DEVNULL,
    )
    return python


Step = tuple[str, list[str], float]


def _steps(python: Path, gone: Sequence[str], workers: str) -> Iterator[Step]:
    program = str(python.with_name("armadico"))
    yield "run sc4 --virtual", [program, "run", "sc4", "--virtual", "--seed", "1"], SOON_S
    tests = [name for name in FOLDERS if name not in gone] or ["core", "robot"]
    where = [f"tests/{name}" for name in tests]
    pytest = [str(python), "-m", "pytest", "-q", "-n", workers, "-m", "not long", *where]
    yield f"the tests of {', '.join(tests)}", pytest, 1800.0


def _core_steps(python: Path) -> Iterator[Step]:
    yield "two agents of one's own compete", [str(python), "-c", ALONE], SOON_S


def _step(
    name: str, command: Sequence[str], copy: Path, env: Mapping[str, str], within: float
) -> bool:
    began = time.monotonic()
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=copy, env=env, text=True, stdout=pipe, stderr=pipe) as done:
        try:
            out, err = done.communicate(timeout=within)
        except subprocess.TimeoutExpired:
            kill_trees(done)
            out, err = done.communicate()
    took = time.monotonic() - began
    print(f"{'FAILED' if done.returncode else 'ok':6} {took:6.1f} s  {name}", flush=True)
    if done.returncode:
        print(out[-8000:], err[-4000:], flush=True)
    return done.returncode == 0


def _live(python: Path, copy: Path, env: Mapping[str, str], what: str) -> bool:
    """`up` starts a society, `doctor` finds nothing wrong with it, `down` ends it."""
    program = str(python.with_name("armadico"))
    with _society([program, "up", "sc4"], copy, env) as up:
        checks = (
            ("up, and run --attach", [program, "run", "sc4", "--attach"]),
            ("doctor", [program, "doctor"]),
            ("down", [program, "down"]),
        )
        for name, command in checks:
            if not _step(f"{_label(what)}: {name}", command, copy, env, SOON_S):
                return False
        return up.wait(SOON_S) in (0, 130, 143)


@contextmanager
def _society(
    command: Sequence[str], copy: Path, env: Mapping[str, str]
) -> Iterator[subprocess.Popen[str]]:
    out = subprocess.DEVNULL
    process = subprocess.Popen(command, cwd=copy, env=env, text=True, stdout=out, stderr=out)
    try:
        yield process
    finally:
        kill_trees(process)


if __name__ == "__main__":
    sys.exit(main())
