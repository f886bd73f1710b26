"""How the synchronous client makes its calls: one connection, one deadline for each call, repetitions, streams."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar

import grpc

from graspd import requests, versions
from graspd.cancellation import Cancellation, cancelled
from graspd.connection import Settings
from graspd.errors import CallError, ConnectError, UnavailableError, UnimplementedError, from_status, late
from graspd.retry import Attempts, RetryPolicy
from graspd.v1 import (
    hand_service_pb2_grpc,
    info_service_pb2,
    info_service_pb2_grpc,
    planner_service_pb2_grpc,
    servo_service_pb2_grpc,
)

_T = TypeVar("_T")
_M = TypeVar("_M")
_C = TypeVar("_C", covariant=True)
_CONNECT_PAUSE = 0.05


class _Pending(Protocol[_C]):
    """A unary call under way."""

    def result(self) -> _C: ...
    def cancel(self) -> bool: ...


class _Messages(Protocol[_C]):
    """A stream under way."""

    def __next__(self) -> _C: ...
    def cancel(self) -> bool: ...


class Connection:
    """A connection to a server, and what every call over it has in common."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        target = settings.resolved()
        self.address = target.address
        """Where the server is."""
        options = settings.options(target)
        self._channel = (
            grpc.insecure_channel(target.address, options)
            if target.tls is None
            else grpc.secure_channel(target.address, target.tls.credentials(), options)
        )
        self._planner = planner_service_pb2_grpc.PlannerServiceStub(self._channel)
        self._hands = hand_service_pb2_grpc.HandServiceStub(self._channel)
        self._info = info_service_pb2_grpc.InfoServiceStub(self._channel)
        self._servo = servo_service_pb2_grpc.ServoServiceStub(self._channel)
        self.server: versions.ServerInfo | None
        """What the server said about itself; None for one that does not, with `check_version=False`."""
        try:
            self.server = self._greet()
        except BaseException:
            self._channel.close()
            raise

    def close(self) -> None:
        """Ends the connection; calls under way are cancelled."""
        self._channel.close()

    @property
    def _metadata(self) -> tuple[tuple[str, str], ...]:
        return self._settings.metadata()

    def _id(self, request_id: str | None) -> str:
        return requests.chosen_id(request_id, self._settings.retry)

    def _timeout(self, timeout: float | None) -> float:
        return self._settings.timeout if timeout is None else timeout

    def _unary(
        self,
        start: Callable[[float], _Pending[_M]],
        timeout: float | None,
        policy: RetryPolicy,
        cancellation: Cancellation | None = None,
    ) -> _M:
        switch = cancellation or Cancellation()
        attempts = Attempts(policy, self._timeout(timeout))
        while True:
            switch.check()
            left = attempts.left
            if left <= 0:
                raise late()
            try:
                return _result(start(left), switch)
            except CallError as error:
                switch.sleep(attempts.after(error))

    def _greet(self) -> versions.ServerInfo | None:
        """Asks the server who it is, until it answers or the time for connecting is up."""
        deadline = time.monotonic() + self._settings.connect_timeout
        request = info_service_pb2.GetServerInfoRequest()
        while True:
            left = max(deadline - time.monotonic(), 0.001)
            try:
                answer: info_service_pb2.GetServerInfoResponse = _result(
                    self._info.GetServerInfo.future(request, timeout=left, metadata=self._metadata),
                    Cancellation(),
                )
            except UnavailableError as error:
                if time.monotonic() + _CONNECT_PAUSE >= deadline:
                    raise ConnectError(f"cannot connect to {self.address}: {error.message}") from error
                time.sleep(_CONNECT_PAUSE)
            except TimeoutError as error:
                raise ConnectError(
                    f"cannot connect to {self.address}: no answer within {self._settings.connect_timeout} s"
                ) from error
            except UnimplementedError as error:
                if self._settings.check_version:
                    raise versions.unknown(self.address) from error
                return None
            else:
                return versions.accepted(answer, self.address, self._settings.check_version)


def _result(call: _Pending[_M], switch: Cancellation) -> _M:
    """Waits for a call; an interrupt, or the switch, ends it on the server too."""
    try:
        with switch.ending(call.cancel):
            return call.result()
    except grpc.FutureCancelledError:
        raise cancelled() from None
    except grpc.RpcError as error:
        raise from_rpc(error) from None
    except BaseException:
        call.cancel()
        raise


def from_rpc(error: grpc.RpcError) -> CallError:
    """The error of a call, from that of the transport."""
    # Every error of a call that was made is the call as well.
    assert isinstance(error, grpc.Call)
    return from_status(error.code(), error.details(), error.trailing_metadata())


class Stream(Generic[_T]):
    """Answers that come in several messages, bounded by the call's deadline.

    An iterator. Until its first message it is repeated as any call. Leaving its `with` block, or `cancel()` from any
    thread, ends the work on the server.
    """

    def __init__(
        self, start: Callable[[float], _Messages[Any]], parse: Callable[[Any], _T], attempts: Attempts
    ) -> None:
        self._start = start
        self._parse = parse
        self._attempts = attempts
        self._switch = Cancellation()
        self._messages: _Messages[Any] | None = None
        self._ended = False

    def __iter__(self) -> Stream[_T]:
        return self

    def __next__(self) -> _T:
        if self._ended:
            raise StopIteration
        try:
            return self._parse(self._read())
        except BaseException:
            # The end, an error, or an interrupt: whatever it was, nothing comes after it.
            self._ended = True
            if self._messages is not None:
                self._messages.cancel()
            raise

    def _read(self) -> Any:
        if self._messages is not None:
            return self._next(self._messages)
        while True:
            self._switch.check()
            left = self._attempts.left
            if left <= 0:
                raise late()
            self._messages = self._start(left)
            try:
                return self._next(self._messages)
            except CallError as error:
                self._messages = None
                self._switch.sleep(self._attempts.after(error))

    def _next(self, messages: _Messages[Any]) -> Any:
        try:
            with self._switch.ending(messages.cancel):
                return next(messages)
        except grpc.RpcError as error:
            if self._switch.cancelled:
                raise cancelled() from None
            raise from_rpc(error) from None

    def cancel(self) -> None:
        """Ends the work; a thread that waits for the next message gets `CancelledError`."""
        self._switch.cancel()
        messages = self._messages
        if messages is not None:
            messages.cancel()

    def __del__(self) -> None:
        # A loop that breaks outside of a `with` block leaves nobody who could read on. One that was never built
        # completely has no messages.
        messages = getattr(self, "_messages", None)
        if messages is not None:
            messages.cancel()

    def __enter__(self) -> Stream[_T]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended = True
        self.cancel()
