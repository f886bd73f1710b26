"""The asynchronous servo stream: as `graspd.Servo`, with `await`."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import TracebackType
from typing import Any

import grpc
import grpc.aio

from graspd.aio_calls import Ending, within
from graspd.errors import GraspdError, late
from graspd.frames import DepthFrame
from graspd.servo import HandPosture, Numbers, ServoAnswer, answer_from_wire
from graspd.v1 import servo_service_pb2 as wire


class AsyncServo:
    """A grasp that is carried on from frame to frame. Use it in an `async with` block: leaving it ends the work.

    `step` sends a frame and waits for the answer to it. Where a camera does not wait for answers, one task `send`s and
    another iterates: the server answers the newest frame that it has, so there may be fewer answers than frames.
    """

    def __init__(self, start: Callable[[], Any], config: wire.ServoGraspRequest, answer_timeout: float) -> None:
        self._config: wire.ServoGraspRequest | None = config
        self._numbers = Numbers()
        self._sending = asyncio.Lock()
        self._answer_timeout = answer_timeout
        self._ended = False
        self._finished = False
        self._call = start()
        self._ending = Ending(self._call)

    async def send(self, frame: DepthFrame, *, hand: HandPosture | None = None, sequence: int | None = None) -> int:
        """Sends a frame, as `graspd.Servo.send`; waits while the connection is slower than the camera."""
        # Frames of several tasks go out in the order of their numbers.
        async with self._sending:
            if self._ended or self._finished:
                raise GraspdError("the servo stream has ended")
            message = self._numbers.message(frame, hand, sequence)
            if self._config is not None:
                config, self._config = self._config, None
                await self._write(config)
            await self._write(message)
        return message.frame.sequence

    async def _write(self, message: wire.ServoGraspRequest) -> None:
        try:
            await self._call.write(message)
        except (grpc.aio.AioRpcError, asyncio.InvalidStateError):
            # Whoever reads gets to know why it has ended.
            self._finished = True

    async def step(self, frame: DepthFrame, *, hand: HandPosture | None = None) -> ServoAnswer:
        """Sends a frame and waits for the answer to it, as `graspd.Servo.step`."""
        number = await self.send(frame, hand=hand)
        async for answer in self:
            if answer.sequence >= number:
                return answer
        raise GraspdError("the servo stream has ended")

    def __aiter__(self) -> AsyncServo:
        return self

    async def __anext__(self) -> ServoAnswer:
        """The next answer; errors as of `graspd.Servo`."""
        if self._ended:
            raise StopAsyncIteration
        try:
            message = await within(self._answer_timeout, self._ending.result(self._call.read()))
            if message is grpc.aio.EOF:
                raise StopAsyncIteration
            return answer_from_wire(message)
        except asyncio.TimeoutError:
            self.cancel()
            raise late() from None
        except BaseException:
            # The end, an error, or a cancelled task: whatever it was, nothing comes after it.
            self.cancel()
            raise

    async def finish(self) -> None:
        """No more frames: the answers end after the last one."""
        async with self._sending:
            if not (self._ended or self._finished):
                self._finished = True
                await self._call.done_writing()

    def cancel(self) -> None:
        """Ends the work."""
        self._ended = True
        self._call.cancel()

    async def __aenter__(self) -> AsyncServo:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.cancel()

    def __del__(self) -> None:
        call = getattr(self, "_call", None)
        if call is not None and not call.done():
            call.cancel()
