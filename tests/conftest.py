"""What holds for all tests."""

from __future__ import annotations

import fcntl
import gc
import os
import signal
import sys
from collections.abc import Generator, Iterator
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, settings

from armadico.mesh.sockets import RUNTIME_VARIABLE
from tests.once import Once
from tests.runtime_folder import session_folder

# Hundreds of processes are started, and each would compile all that it imports, where the
# environment says that nothing compiled is to be kept.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Machines are shared: how long an example takes says nothing, and no assertion rests on it.
settings.register_profile("shared", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("shared")


SELDOM = 20_000
"""Objects more than there were, after which rings of them are looked for: with every 700, as by
default, that is a twelfth of the tests' time."""


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Have a file of tests that nobody has compiled yet compiled by one worker, for all."""
    if not isinstance(collector, pytest.Module):
        return (yield)
    with collector.path.open() as file:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        return (yield)


def pytest_collection(session: pytest.Session) -> None:
    """All that is collected stays."""
    gc.disable()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Have it looked at never again."""
    gc.freeze()
    gc.set_threshold(SELDOM)
    gc.enable()


@pytest.hookimpl(tryfirst=True)  # before `-m` selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Take the marker `long` from the parameter sets that it names in `but`."""
    for item in items:
        marker = item.get_closest_marker("long")
        if marker is None or not isinstance(item, pytest.Function):
            continue
        short: tuple[str, ...] = marker.kwargs.get("but", ())
        if hasattr(item, "callspec") and item.callspec.id in short:
            item.own_markers[:] = [each for each in item.own_markers if each.name != "long"]


@pytest.fixture(scope="session", autouse=True)
def sockets_of_its_own() -> Iterator[None]:
    """Have the processes of a session's tests find each other, and nobody else's.

    What programs keep for their user, such as places and rehearsals, goes with the session, too.
    """
    with session_folder() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv(RUNTIME_VARIABLE, folder)
        patch.setenv("XDG_DATA_HOME", f"{folder}/data")
        yield


@pytest.fixture(scope="session", autouse=True)
def programs_receive_signals() -> Iterator[None]:
    """Have Ctrl-C and SIGHUP reach the tests' programs when the suite itself ignores them.

    A program inherits an ignored signal, and `nohup make test &` ignores both. A handler is not
    inherited: the program starts with the default, and SIGHUP still does not end the suite.
    """
    handlers = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: lambda *_: None}
    ignored = [number for number in handlers if signal.getsignal(number) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, handlers[number])
    yield
    for number in ignored:
        signal.signal(number, signal.SIG_IGN)


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Have something made once in this session, whatever worker asks for it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # each worker has a folder of its own in the session's
    kept = folder / "once"
    kept.mkdir(exist_ok=True)
    return Once(kept)
