"""Signals that end a command as Ctrl-C does: files stay whole, and the last words say how to go on."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_PATIENCE = 5.0
"""Seconds in which a repeated signal means nothing new: terminals and their shells send one each."""


class EndedBySignal(KeyboardInterrupt):
    """A signal asked this process to end.

    Attributes:
        number: Which one.
    """

    def __init__(self, number: int) -> None:
        """Take the number of the signal."""
        super().__init__(signal.Signals(number).name)
        self.number = number


def exit_code(stop: KeyboardInterrupt) -> int:
    """Return the exit code that shells give to a signal: 130 for Ctrl-C, 143 for SIGTERM."""
    return 128 + (stop.number if isinstance(stop, EndedBySignal) else signal.SIGINT)


@contextmanager
def handle_signals() -> Iterator[None]:
    """Let signals end a block with `EndedBySignal`. Those that are ignored stay so, as ``nohup`` wants it.

    SIGUSR1 is among them in a job of Slurm, which sends it before the time is up.
    """
    if threading.current_thread() is not threading.main_thread():  # others hear nothing
        yield
        return
    names = ("SIGTERM", "SIGHUP", *(("SIGUSR1",) if "SLURM_JOB_ID" in os.environ else ()))
    numbers = [signal.Signals[name] for name in names if hasattr(signal, name)]
    mine = [number for number in numbers if signal.getsignal(number) == signal.SIG_DFL]
    handler = _handler()
    _handlers.update(dict.fromkeys(mine, handler))
    reinstall_handlers()
    try:
        yield
    finally:
        for number in mine:
            del _handlers[number]
            signal.signal(number, signal.SIG_DFL)


def reinstall_handlers() -> None:
    """Reinstall our signal handlers after a library has installed its own."""
    for number, handler in _handlers.items():
        signal.signal(number, handler)


_handlers: dict[int, Callable[[int, FrameType | None], None]] = {}


def _handler() -> Callable[[int, FrameType | None], None]:
    last = -_PATIENCE

    def end(number: int, frame: FrameType | None) -> None:
        nonlocal last
        repeated, last = time.monotonic() < last + _PATIENCE, time.monotonic()
        if not repeated:
            if number == getattr(signal, "SIGHUP", None):
                _leave_terminal()
            raise EndedBySignal(number)

    return end


def _leave_terminal() -> None:
    """Send what is still printed nowhere where the terminal is gone: printing would be an error."""
    for place in (1, 2):
        try:
            os.write(place, b"")
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), place)
