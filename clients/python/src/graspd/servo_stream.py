"""The synchronous servo stream: frames out at the camera's pace, the newest first; answers in."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Protocol

import grpc

from graspd.calls import from_rpc
from graspd.cancellation import cancelled
from graspd.errors import CallError, GraspdError, late
from graspd.frames import DepthFrame
from graspd.servo import HandPosture, Numbers, ServoAnswer, answer_from_wire
from graspd.v1 import servo_service_pb2 as wire


class _Call(Protocol):
    """A stream in both directions."""

    def __next__(self) -> wire.ServoGraspResponse: ...
    def cancel(self) -> bool: ...


class _Outgoing:
    """Messages on their way to the connection, which asks for the next when it has room: the newest frame waits."""

    def __init__(self, first: wire.ServoGraspRequest) -> None:
        self._changed = threading.Condition()
        self._first: wire.ServoGraspRequest | None = first
        self._frame: wire.ServoGraspRequest | None = None
        self._ended = False
        self.replaced = 0

    def put(self, frame: wire.ServoGraspRequest) -> None:
        with self._changed:
            if self._ended:
                raise GraspdError("the servo stream has ended")
            self.replaced += self._frame is not None
            self._frame = frame
            self._changed.notify()

    def end(self) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify()

    def __iter__(self) -> Iterator[wire.ServoGraspRequest]:
        return self

    def __next__(self) -> wire.ServoGraspRequest:
        # Called by a thread of the transport, which ends with the call.
        with self._changed:
            if self._first is not None:
                first, self._first = self._first, None
                return first
            self._changed.wait_for(lambda: self._frame is not None or self._ended)
            frame, self._frame = self._frame, None
        if frame is None:
            raise StopIteration
        return frame


class Servo:
    """A grasp that is carried on from frame to frame. Use it in a `with` block: leaving it ends the work.

    `step` sends a frame and waits for its answer. Where a camera does not wait for answers, one thread `send`s and
    another iterates: the server answers the newest frame that it has, so there may be fewer answers than frames.
    """

    def __init__(
        self,
        start: Callable[[Iterator[wire.ServoGraspRequest]], _Call],
        config: wire.ServoGraspRequest,
        answer_timeout: float,
    ) -> None:
        self._outgoing = _Outgoing(config)
        self._numbers = Numbers()
        self._numbering = threading.Lock()
        self._answer_timeout = answer_timeout
        self._cancelled = False
        self._is_late = False
        self._ended = False
        self._call = start(self._outgoing)

    @property
    def replaced(self) -> int:
        """Frames that a newer one has replaced before the connection had room for them."""
        return self._outgoing.replaced

    def send(self, frame: DepthFrame, *, hand: HandPosture | None = None, sequence: int | None = None) -> int:
        """Sends a frame; never waits: a frame that is still waiting for the connection is replaced.

        Args:
            frame: What the camera sees, with its `camera_pose`. Its `capture_time` says how far frames are apart.
            hand: Where the hand was, for a camera that can see it.
            sequence: The frame's number; it has to rise. None: the next.

        Returns:
            The frame's number.

        Raises:
            ValueError: If the frame has no pose, or the number does not rise.
            GraspdError: If the stream has ended.
        """
        with self._numbering:
            message = self._numbers.message(frame, hand, sequence)
            self._outgoing.put(message)
        return message.frame.sequence

    def step(self, frame: DepthFrame, *, hand: HandPosture | None = None) -> ServoAnswer:
        """Sends a frame and waits for the answer to it; one frame at a time.

        Raises:
            DeadlineExceededError: If no answer comes in time. A frame that the server refuses (from where the camera
                cannot have gone, or unreadable) has no answer; `send` and iterate where that may happen.
            CallError: If the server ends the stream, for example `InvalidArgumentError` for an option.
        """
        number = self.send(frame, hand=hand)
        for answer in self:
            if answer.sequence >= number:
                return answer
        raise GraspdError("the servo stream has ended")

    def __iter__(self) -> Servo:
        return self

    def __next__(self) -> ServoAnswer:
        """The next answer; waits for it.

        Raises:
            DeadlineExceededError: If none comes in time; the stream is over then.
            CallError: If the server ends the stream.
        """
        if self._ended:
            raise StopIteration
        watchdog = threading.Timer(self._answer_timeout, self._too_late)
        watchdog.daemon = True
        watchdog.start()
        try:
            return answer_from_wire(next(self._call))
        except grpc.RpcError as error:
            raise self._reason(error) from None
        except BaseException:
            self._end()
            raise
        finally:
            watchdog.cancel()

    def _reason(self, error: grpc.RpcError) -> CallError:
        self._end()
        if self._is_late:
            return late()
        return cancelled() if self._cancelled else from_rpc(error)

    def _too_late(self) -> None:
        self._is_late = True
        self._call.cancel()

    def _end(self) -> None:
        self._ended = True
        self._outgoing.end()
        self._call.cancel()

    def finish(self) -> None:
        """No more frames: the answers end after the last one."""
        self._outgoing.end()

    def cancel(self) -> None:
        """Ends the work; a thread that waits for an answer gets `CancelledError`."""
        self._cancelled = True
        self._outgoing.end()
        self._call.cancel()

    def __enter__(self) -> Servo:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended = True
        self.cancel()

    def __del__(self) -> None:
        # One that was never built completely has no call.
        if getattr(self, "_call", None) is not None:
            self.cancel()
