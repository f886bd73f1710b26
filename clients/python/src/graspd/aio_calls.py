"""How the asynchronous client makes its calls: a channel of one event loop, errors, streams."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from types import TracebackType
from typing import Any, Generic, TypeVar

import grpc
import grpc.aio

from graspd.connection import Settings
from graspd.errors import CallError, from_status, late
from graspd.retry import Attempts
from graspd.v1 import (
    hand_service_pb2_grpc,
    info_service_pb2_grpc,
    planner_service_pb2_grpc,
    servo_service_pb2_grpc,
)

_T = TypeVar("_T")


class AsyncConnection:
    """A channel and its stubs."""

    def __init__(self, settings: Settings) -> None:
        target = settings.resolved()
        options = settings.options(target)
        self.channel = (
            grpc.aio.insecure_channel(target.address, options)
            if target.tls is None
            else grpc.aio.secure_channel(target.address, target.tls.credentials(), options)
        )
        self.planner = planner_service_pb2_grpc.PlannerServiceStub(self.channel)
        self.hands = hand_service_pb2_grpc.HandServiceStub(self.channel)
        self.info = info_service_pb2_grpc.InfoServiceStub(self.channel)
        self.servo = servo_service_pb2_grpc.ServoServiceStub(self.channel)


async def result(call: Awaitable[_T]) -> _T:
    """Waits for a call; its error is one of ours."""
    try:
        return await call
    except grpc.aio.AioRpcError as error:
        raise from_status(error.code(), error.details(), error.trailing_metadata()) from None


async def within(seconds: float, awaited: Awaitable[_T]) -> _T:
    """`asyncio.wait_for`, which before Python 3.12 loses a cancellation that comes together with the result."""
    task = asyncio.ensure_future(awaited)
    try:
        done, _ = await asyncio.wait({task}, timeout=seconds)
    except asyncio.CancelledError:
        _drop(task)
        raise
    if not done:
        _drop(task)
        raise asyncio.TimeoutError
    return task.result()


def _drop(task: asyncio.Future[Any]) -> None:
    """Nobody waits for it any more: neither its result nor its error is wanted."""
    task.cancel()
    task.add_done_callback(lambda ended: ended.cancelled() or ended.exception())


class Ending:
    """The status with which a stream ended, as it first came.

    A write that meets a stream which the server has ended overwrites the server's status with INTERNAL in grpc.aio
    (grpc/grpc#36066), so it is read in the moment in which it comes.
    """

    def __init__(self, call: Any) -> None:
        self._error: CallError | None = None
        call.add_done_callback(self._note)

    def _note(self, call: Any) -> None:
        code = _at_once(call.code())
        if self._error is None and code not in (None, grpc.StatusCode.OK):
            self._error = from_status(code, _at_once(call.details()), _at_once(call.trailing_metadata()))

    async def result(self, call: Awaitable[_T]) -> _T:
        """Waits for a read; its error is the one with which the stream ended first."""
        try:
            return await result(call)
        except CallError as error:
            raise self._error or error from None


def _at_once(asked: Coroutine[Any, Any, _T]) -> _T | None:
    """What a coroutine that has nothing to wait for gives; None if it would wait."""
    try:
        asked.send(None)
    except StopIteration as end:
        return end.value  # type: ignore[no-any-return]
    asked.close()
    return None


class AsyncStream(Generic[_T]):
    """Answers that come in several messages, bounded by the call's deadline.

    An asynchronous iterator. Until its first message it is repeated as any call. Leaving its `async with` block, or
    `cancel()`, ends the work on the server.
    """

    def __init__(self, start: Callable[[float], Any], parse: Callable[[Any], _T], attempts: Attempts) -> None:
        self._start = start
        self._parse = parse
        self._attempts = attempts
        self._call: Any = None
        self._ended = False

    def __aiter__(self) -> AsyncStream[_T]:
        return self

    async def __anext__(self) -> _T:
        if self._ended:
            raise StopAsyncIteration
        try:
            message = await self._read()
            if message is grpc.aio.EOF:
                raise StopAsyncIteration
            return self._parse(message)
        except BaseException:
            # The end, an error, or a cancelled task: whatever it was, nothing comes after it.
            self.cancel()
            raise

    async def _read(self) -> Any:
        if self._call is not None:
            return await result(self._call.read())
        while True:
            left = self._attempts.left
            if left <= 0:
                raise late()
            self._call = self._start(left)
            try:
                return await result(self._call.read())
            except CallError as error:
                self._call = None
                wait = self._attempts.after(error)
            await asyncio.sleep(wait)

    def cancel(self) -> None:
        """Ends the work."""
        self._ended = True
        if self._call is not None:
            self._call.cancel()

    def __del__(self) -> None:
        # A loop that breaks outside of an `async with` block leaves nobody who could read on.
        call = getattr(self, "_call", None)
        if call is not None and not call.done():
            call.cancel()

    async def __aenter__(self) -> AsyncStream[_T]:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.cancel()
