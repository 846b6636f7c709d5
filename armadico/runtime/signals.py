"""The signals that end a process in order, and threads that wait for signals."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Mapping
from typing import Final

LEAVE_S: Final = 3.0  # timeout from the signal to the end of the process, whatever hangs


def ending() -> frozenset[signal.Signals]:
    """Return the signals that end this process in order.

    A closed terminal sends SIGHUP. It is not among them where it is ignored, as after `nohup`.
    """
    found = frozenset({signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
    return found - {signal.SIGHUP} if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else found


def await_signals(then: Mapping[int, Callable[[], None]]) -> None:
    """Start a thread that calls a function at each signal of these; from the main thread, once.

    Zenoh's threads may receive the signal: Python then writes its number to the pipe, whatever the
    main thread does.
    """
    numbers, written = os.pipe()
    os.set_blocking(written, False)
    for number in then:
        signal.signal(number, lambda *_: None)
    signal.set_wakeup_fd(written, warn_on_full_buffer=False)

    def wait() -> None:
        while number := os.read(numbers, 1):
            if number[0] in then:
                then[number[0]]()

    threading.Thread(target=wait, name="signals", daemon=True).start()


def await_end(leave: Callable[[], None]) -> None:
    """Start a thread that waits for a signal of `ending`; call it before there are other threads.

    A signal handler does not suffice: if the signal arrives just before the wait for the inbox, the
    handler runs only after that wait, which without messages is never.
    """
    numbers = ending()
    signal.pthread_sigmask(signal.SIG_BLOCK, numbers)  # inherited by every thread from here on

    def wait() -> None:
        signal.sigwait(numbers)
        arm_deadline()
        leave()

    threading.Thread(target=wait, name="end", daemon=True).start()


def arm_deadline() -> None:
    """Start the timer that kills this process after `LEAVE_S`, unless it runs already."""
    if signal.getitimer(signal.ITIMER_REAL)[0] == 0.0:
        signal.setitimer(signal.ITIMER_REAL, LEAVE_S)
