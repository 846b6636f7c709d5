"""A real ROS 2 for tests: rclpy from the package registry, in an environment of its own.

`python -m tests.real_ros` makes it, once for each lock and Python of a machine, below the user's
cache, so that the next clone need not fetch 170 MB again. It takes a bounded time and may fail:
then the tests that want it are skipped, with the reason.
"""

from __future__ import annotations

import hashlib
import itertools
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

LOCK = Path(__file__).parents[1] / "requirements" / "rclpy.txt"
BOUND_S = 420.0
"""How long the download may take in all."""
NOBODYS = 101
"""A DDS domain that `own_domain` never gives; higher ones take ports that the system gives out."""
_SHARE = 25
_drawn = itertools.count(os.getpid())


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "armadico"


def place() -> Path:
    """Where the environment is, or would be."""
    lock = hashlib.sha256(LOCK.read_bytes()).hexdigest()[:12]
    return _cache() / f"rclpy-{lock}-{sys.implementation.cache_tag}"


def interpreter() -> str:
    """A Python that has rclpy; skips the test where there is none."""
    python = place() / "bin" / "python"
    if not python.exists():
        why = _reason()
        reason = why.read_text() if why.exists() else "`make test` fetches it"
        pytest.skip(f"no rclpy here: {reason}")
    return str(python)


def own_domain() -> int:
    """A DDS domain from 1 to 100 that no other test has: neither one that runs now, in another of
    four workers of pytest-xdist, nor one of the last, whose killed node is there for 20 s more."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
    return 1 + worker % 4 * _SHARE + next(_drawn) % _SHARE


def environment(domain: str) -> dict[str, str]:
    """Where a node of it talks to this machine alone."""
    return {
        **{name: value for name, value in os.environ.items() if not name.startswith("ROS_")},
        "ROS_DOMAIN_ID": domain,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_LOG_DIR": tempfile.gettempdir(),
    }


def _reason() -> Path:
    return place().with_suffix(".why")


def _make() -> str:
    """Make the environment; why that was not to be, or "" ."""
    made = place()
    if (made / "bin" / "python").exists():
        return ""
    made.parent.mkdir(parents=True, exist_ok=True)
    # Beside it, and moved there when done: another clone may be at it too.
    draft = Path(tempfile.mkdtemp(prefix="rclpy-", dir=made.parent))
    try:
        run = [sys.executable, "-m", "venv", "--without-pip", draft / "venv"]
        subprocess.run(run, check=True, timeout=60)
        sys.stderr.write(f"A real ROS 2 for the tests, once: 170 MB into {made}\n")
        subprocess.run(
            [
                *(sys.executable, "-m", "pip", "--disable-pip-version-check", "--python"),
                *(draft / "venv" / "bin" / "python", "install", "--quiet", "--require-hashes"),
                *("-r", LOCK),
            ],
            check=True,
            timeout=BOUND_S,
        )
        (draft / "venv").rename(made)
    except subprocess.TimeoutExpired:
        return f"it did not come within {BOUND_S:g} s"
    except (subprocess.CalledProcessError, OSError) as error:
        return "" if (made / "bin" / "python").exists() else f"it could not be installed: {error}"
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return ""


def main() -> int:
    """Make it, and keep why if that failed; that is no failure of the tests."""
    why = _make()
    if why:
        sys.stderr.write(f"no rclpy, so some tests will be skipped: {why}\n")
        _reason().parent.mkdir(parents=True, exist_ok=True)
        _reason().write_text(why)
    else:
        _reason().unlink(missing_ok=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
