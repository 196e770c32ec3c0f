"""Ctrl-C and SIGTERM, so that neither is lost.

Python raises `KeyboardInterrupt` wherever it happens to be. A compiled library may swallow that, or raise something else in
its place; so it is noted too, and asked for where work can stop.
"""

import signal
from threading import Event
from typing import Any

_asked = Event()


def listen() -> None:
    """From now on both signals interrupt this process, and are noted."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)


def are_asked() -> bool:
    """Whether either has come, whatever became of the exception."""
    return _asked.is_set()


def stop_if_asked() -> None:
    """Raise `KeyboardInterrupt`, again if need be, when either has come."""
    if _asked.is_set():
        raise KeyboardInterrupt


def _interrupt(signum: int, frame: Any) -> None:
    _asked.set()
    raise KeyboardInterrupt
