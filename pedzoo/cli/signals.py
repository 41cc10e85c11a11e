"""Signals that end a command as Ctrl-C does: files stay whole, and the last words say how to go on."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_PATIENCE = 5.0
"""Seconds in which a repeated signal means nothing new: terminals and their shells send one each."""


class EndedBySignal(KeyboardInterrupt):
    """A signal, ``number``, asked this process to end."""

    def __init__(self, number: int) -> None:
        """Take the number of the signal."""
        super().__init__(signal.Signals(number).name)
        self.number = number


def exit_code(stop: KeyboardInterrupt) -> int:
    """Return the exit code that shells give to a signal: 130 for Ctrl-C, 143 for SIGTERM."""
    return 128 + (stop.number if isinstance(stop, EndedBySignal) else signal.SIGINT)


class _Handler:
    """Ends the main thread by `EndedBySignal`, once for repeated signals."""

    last = -_PATIENCE

    def __call__(self, number: int, frame: FrameType | None) -> None:
        repeated, self.last = time.monotonic() < self.last + _PATIENCE, time.monotonic()
        if repeated:
            return
        if number == getattr(signal, "SIGHUP", None):
            for place in (1, 2):  # where the terminal is gone, printing would be an error
                try:
                    os.write(place, b"")
                except OSError:
                    os.dup2(os.open(os.devnull, os.O_WRONLY), place)
        raise EndedBySignal(number)


_handlers: dict[int, _Handler] = {}


@contextmanager
def handle_signals() -> Iterator[None]:
    """Let signals end a block of the main thread. Those that are ignored stay so, as ``nohup`` wants it.

    SIGUSR1 is among them in a job of Slurm, which sends it before the time is up.
    """
    mine: list[int] = []
    if threading.current_thread() is threading.main_thread():
        names = ("SIGTERM", "SIGHUP", *(("SIGUSR1",) if "SLURM_JOB_ID" in os.environ else ()))
        numbers = [signal.Signals[name] for name in names if hasattr(signal, name)]
        mine += [number for number in numbers if signal.getsignal(number) == signal.SIG_DFL]
        _handlers.update(dict.fromkeys(mine, _Handler()))
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
