"""When a call is tried again, and after how long.

Only what is safe and useful is repeated: `UNAVAILABLE` (the server is starting, draining or gone for a moment) after an
exponential back-off with jitter, and `RESOURCE_EXHAUSTED` where the server itself says when to come back. Everything
happens within the call's one deadline. Calls that change something (create and delete of hands) are never repeated, and
a stream is not repeated once it has begun.
"""

from __future__ import annotations

import random
import time
from dataclasses import dataclass

import grpc

from graspd.errors import CallError


@dataclass(frozen=True)
class RetryPolicy:
    """How often and after how long a call is repeated."""

    attempts: int = 4
    """Attempts in all; 1 never repeats."""
    first_backoff: float = 0.05
    """First back-off, seconds; each further one is twice as long."""
    longest_backoff: float = 1.0
    """Longest back-off, seconds."""

    def __post_init__(self) -> None:
        if self.attempts < 1:
            raise ValueError(f"attempts: found {self.attempts}, expected 1 or more")
        if not 0 <= self.first_backoff <= self.longest_backoff:
            raise ValueError(
                f"first_backoff: found {self.first_backoff}, expected 0 to longest_backoff ({self.longest_backoff})"
            )

    def wait(self, error: CallError, attempt: int, jitter: float) -> float | None:
        """Seconds to wait after attempt `attempt` (the first is 1) failed, or None to give up.

        `jitter` is 0 to 1: everybody who was refused comes back, but not all at once.
        """
        if attempt >= self.attempts:
            return None
        if error.code is grpc.StatusCode.RESOURCE_EXHAUSTED and error.retry_after is not None:
            return error.retry_after * (1.0 + 0.5 * jitter)
        if error.code is grpc.StatusCode.UNAVAILABLE:
            doubled: float = self.first_backoff * 2.0 ** min(attempt - 1, 16)
            backoff = min(doubled, self.longest_backoff) * (0.5 + 0.5 * jitter)
            return max(backoff, error.retry_after or 0.0)
        return None


DEFAULT = RetryPolicy()
"""4 attempts, back-off from 50 ms to 1 s."""
NEVER = RetryPolicy(attempts=1)
"""Never repeats."""


class Attempts:
    """The attempts of one call: how much time is left, and whether there is another."""

    def __init__(self, policy: RetryPolicy, timeout: float) -> None:
        self._policy = policy
        self._deadline = time.monotonic() + timeout
        self._made = 0

    @property
    def left(self) -> float:
        """Seconds to the call's deadline; negative when it has passed."""
        return self._deadline - time.monotonic()

    def after(self, error: CallError) -> float:
        """Seconds to wait before the next attempt.

        Raises:
            CallError: `error`, if it is not to be repeated, or the deadline would pass first.
        """
        self._made += 1
        wait = self._policy.wait(error, self._made, random.random())
        if wait is None or wait >= self.left:
            raise error
        return wait
