"""Cancelling a call from another thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import grpc

from graspd.errors import CallError, call_error


class Cancellation:
    """A switch: whoever holds it can end the calls that it was given to, from any thread, now or before they begin.

    The call raises `CancelledError`, and the server stops working on it.
    """

    def __init__(self) -> None:
        self._event = threading.Event()
        self._lock = threading.Lock()
        self._ends: set[Callable[[], object]] = set()

    @property
    def cancelled(self) -> bool:
        """Whether it was thrown."""
        return self._event.is_set()

    def cancel(self) -> None:
        """Ends the calls."""
        with self._lock:
            self._event.set()
            ends = list(self._ends)
        for end in ends:
            end()

    @contextmanager
    def ending(self, end: Callable[[], object]) -> Iterator[None]:
        """While this lasts, `cancel` calls `end`; at once if it was called before."""
        with self._lock:
            self._ends.add(end)
            thrown = self._event.is_set()
        try:
            if thrown:
                end()
            yield
        finally:
            with self._lock:
                self._ends.discard(end)

    def sleep(self, seconds: float) -> None:
        """Waits, but not when cancelled."""
        self._event.wait(seconds)

    def check(self) -> None:
        """Raises `CancelledError` if it was thrown."""
        if self._event.is_set():
            raise cancelled()


def cancelled() -> CallError:
    """The error of a call that its caller cancelled."""
    return call_error(grpc.StatusCode.CANCELLED, "the call was cancelled by its caller", reason="CANCELLED")
