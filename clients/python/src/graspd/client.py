"""The synchronous client: one connection, one deadline for each call."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar

import grpc

from graspd import answers, requests, versions
from graspd.cancellation import Cancellation, cancelled
from graspd.connection import Settings, Tls
from graspd.errors import CallError, ConnectError, UnavailableError, UnimplementedError, from_status, late
from graspd.frames import IntrinsicsLike
from graspd.hands import (
    CreatedHand,
    Hand,
    HandFiles,
    HandGeometry,
    HandLike,
    created_from_wire,
    geometry_from_wire,
    hand_from_wire,
    hand_id,
    hand_name,
    read_files,
    upload,
)
from graspd.options import PlanOptions, SceneOptions
from graspd.plans import MultiPlan, Plan, PlanEvent, TaskResult
from graspd.requests import Hands, Scene
from graspd.retry import NEVER, Attempts, RetryPolicy
from graspd.v1 import (
    hand_service_pb2,
    hand_service_pb2_grpc,
    info_service_pb2,
    info_service_pb2_grpc,
    planner_service_pb2,
    planner_service_pb2_grpc,
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


def connect(
    address: str | None = None,
    *,
    timeout: float = 10.0,
    connect_timeout: float = 5.0,
    retry: RetryPolicy | None = None,
    tls: Tls | None = None,
    token: str | None = None,
    check_version: bool = True,
) -> Planner:
    """Connects to a server; repeats until `connect_timeout` is up, so that a server that is starting is waited for.

    Args:
        address: `host:port`, with or without `http://` or `https://`. Without one the environment variable
            `GRASPD_ADDRESS` is asked, then `127.0.0.1:50051`.
        timeout: Deadline of every call, all its attempts together, seconds; calls can name another.
        connect_timeout: How long to wait for the connection, seconds.
        retry: What is repeated; `graspd.RetryPolicy(attempts=1)` never repeats.
        tls: Encryption.
        token: Bearer token that goes with every call.
        check_version: Whether a server that does not fit this client is refused.

    Raises:
        ConnectError: If nobody answers there.
        VersionError: If the server does not fit this client.
        CallError: If the server refuses.
        ValueError: If the address is not one.
    """
    return Planner(
        Settings(
            address=address,
            timeout=timeout,
            connect_timeout=connect_timeout,
            retry=retry or RetryPolicy(),
            tls=tls,
            token=token,
            check_version=check_version,
        )
    )


class Planner:
    """A connection to a server. Thread-safe; close it, or use it in a `with` block.

    Poses are 4 × 4 matrices that take coordinates of the hand's root link to the world frame: the frame of
    `DepthFrame.camera_pose`, or the camera's own optical frame (x right, y down, z forward) where there is none.
    Metres, radians, seconds.
    """

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
        self.server: versions.ServerInfo | None
        """What the server said about itself; None for one that does not, with `check_version=False`."""
        try:
            self.server = self._greet()
        except BaseException:
            self._channel.close()
            raise

    def __enter__(self) -> Planner:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Ends the connection; calls under way are cancelled."""
        self._channel.close()

    def __repr__(self) -> str:
        return f"<graspd.Planner at {self.address}>"

    # --- planning ---

    def plan(
        self,
        scene: Scene,
        intrinsics: IntrinsicsLike | None = None,
        *,
        hand: HandLike,
        options: PlanOptions | None = None,
        scene_options: SceneOptions | None = None,
        request_id: str | None = None,
        timeout: float | None = None,
        cancellation: Cancellation | None = None,
    ) -> Plan:
        """Plans grasps of one hand.

        Args:
            scene: A depth array (uint16 millimetres or float metres) or a PNG file's bytes, with its `intrinsics`; or a
                `DepthFrame`; or several of one moment.
            intrinsics: The lens of a bare depth array: `Intrinsics`, or a 3 × 3 camera matrix.
            hand: The hand's id, for example `"leap"`.
            options: How grasps are searched.
            scene_options: How the scene is read.
            request_id: Makes repeating safe, at most 128 bytes: calls with one id are one call, and a repetition gets
                the answer of the first, up to a minute later. Attempts of one call share an id of their own anyway.
            timeout: Deadline of this call, seconds.
            cancellation: A switch that ends the call from another thread.

        Returns:
            Ranked grasps, best first. None found is no error: `Plan.no_grasp` says why.

        Raises:
            InvalidArgumentError: If a field is wrong; `violations` names it.
            NotFoundError: If there is no such hand.
            ResourceExhaustedError: If the queue is full, after the retries that the server asked for.
            DeadlineExceededError: If there was nothing to answer in time.
            CallError: For everything else that the server says.
            ValueError: If an array cannot be what it should be.
        """
        request = requests.plan_request(scene, intrinsics, hand, options, scene_options, self._id(request_id))
        answer: planner_service_pb2.PlanGraspsResponse = self._unary(
            lambda left: self._planner.PlanGrasps.future(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
            cancellation,
        )
        return answers.plan_from_wire(answer)

    def stream(
        self,
        scene: Scene,
        intrinsics: IntrinsicsLike | None = None,
        *,
        hand: HandLike,
        options: PlanOptions | None = None,
        scene_options: SceneOptions | None = None,
        request_id: str | None = None,
        timeout: float | None = None,
    ) -> Stream[PlanEvent]:
        """Plans grasps of one hand and tells each better set as soon as it is found.

        Args as for `plan`. The stream yields `Accepted`, `Improved` any number of times, and `Finished`; leaving its
        `with` block, or `cancel()`, ends the work.
        """
        request = planner_service_pb2.StreamGraspsRequest(
            plan=requests.plan_request(scene, intrinsics, hand, options, scene_options, self._id(request_id))
        )
        return Stream(
            lambda left: self._planner.StreamGrasps(request, timeout=left, metadata=self._metadata),
            answers.event_from_wire,
            Attempts(self._settings.retry, self._timeout(timeout)),
        )

    def plan_hands(
        self,
        scene: Scene,
        intrinsics: IntrinsicsLike | None = None,
        *,
        hands: Hands,
        options: PlanOptions | None = None,
        scene_options: SceneOptions | None = None,
        request_id: str | None = None,
        timeout: float | None = None,
        cancellation: Cancellation | None = None,
    ) -> MultiPlan:
        """Plans grasps of several hands in one scene: it is sent and read once.

        Args as for `plan`; `hands` are up to 16 ids, or tasks by names of the caller's:
        `{"arm_left": "leap", "arm_right": graspd.HandTask("panda", PlanOptions(seed=3))}`.

        Returns:
            A mapping of results in the order of the question. A hand that fails leaves the others alone:
            `MultiPlan.errors`.

        Raises:
            CallError: If the question as a whole failed; as for `plan`.
        """
        request = requests.multi_hand_request(scene, intrinsics, hands, options, scene_options, self._id(request_id))
        results: list[TaskResult] = []
        summary: planner_service_pb2.MultiHandSummary | None = None
        switch = cancellation or Cancellation()
        with self._multi_hand(request, timeout) as stream, switch.ending(stream.cancel):
            for message in stream:
                if message.WhichOneof("event") == "result":
                    results.append(answers.result_from_wire(message.result))
                else:
                    summary = message.summary
        return answers.multi_plan((t.task_id for t in request.tasks), results, summary)

    def stream_hands(
        self,
        scene: Scene,
        intrinsics: IntrinsicsLike | None = None,
        *,
        hands: Hands,
        options: PlanOptions | None = None,
        scene_options: SceneOptions | None = None,
        request_id: str | None = None,
        timeout: float | None = None,
    ) -> Iterator[TaskResult]:
        """As `plan_hands`, each hand's result as soon as it is ready. Closing the iterator ends the work."""
        request = requests.multi_hand_request(scene, intrinsics, hands, options, scene_options, self._id(request_id))
        return self._results(request, timeout)

    def _results(
        self, request: planner_service_pb2.PlanMultiHandRequest, timeout: float | None
    ) -> Iterator[TaskResult]:
        with self._multi_hand(request, timeout) as stream:
            for message in stream:
                if message.WhichOneof("event") == "result":
                    yield answers.result_from_wire(message.result)

    def _multi_hand(
        self, request: planner_service_pb2.PlanMultiHandRequest, timeout: float | None
    ) -> Stream[planner_service_pb2.PlanMultiHandResponse]:
        return Stream(
            lambda left: self._planner.PlanMultiHand(request, timeout=left, metadata=self._metadata),
            lambda message: message,
            Attempts(self._settings.retry, self._timeout(timeout)),
        )

    # --- hands ---

    def hands(self, *, timeout: float | None = None) -> list[Hand]:
        """All hands of the server, in the order of their ids."""
        found: list[Hand] = []
        token = ""
        while True:
            request = hand_service_pb2.ListHandsRequest(page_token=token)
            page = self._list_hands(request, timeout)
            found += [hand_from_wire(hand) for hand in page.hands]
            token = page.next_page_token
            if not token:
                return found

    def _list_hands(
        self, request: hand_service_pb2.ListHandsRequest, timeout: float | None
    ) -> hand_service_pb2.ListHandsResponse:
        return self._unary(
            lambda left: self._hands.ListHands.future(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )

    def hand(self, hand: HandLike, *, timeout: float | None = None) -> Hand:
        """One hand.

        Raises:
            NotFoundError: If there is no such hand.
        """
        request = hand_service_pb2.GetHandRequest(name=hand_name(hand))
        answer: hand_service_pb2.GetHandResponse = self._unary(
            lambda left: self._hands.GetHand.future(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )
        return hand_from_wire(answer.hand)

    def hand_geometry(self, hand: HandLike, *, timeout: float | None = None) -> HandGeometry:
        """The shape of a hand and how its parts move.

        Raises:
            NotFoundError: If there is no such hand.
        """
        request = hand_service_pb2.GetHandGeometryRequest(name=hand_name(hand))
        answer: hand_service_pb2.GetHandGeometryResponse = self._unary(
            lambda left: self._hands.GetHandGeometry.future(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )
        return geometry_from_wire(hand_id(hand), answer)

    def create_hand(
        self, id: str, files: HandFiles, *, validate_only: bool = False, timeout: float | None = None
    ) -> CreatedHand:
        """Adds a hand from its folder, or from its files' contents by their paths in it; never repeated.

        Args:
            id: The new hand's id: a lower-case letter, then lower-case letters, digits and hyphens.
            files: `hand.urdf`, the meshes that it names, and `hand.toml`; without the last the server proposes one.
            validate_only: Check everything and add nothing.
            timeout: Deadline of this call, seconds.

        Raises:
            InvalidArgumentError: If the files do not make a hand; `violations` names each file and place.
            AlreadyExistsError: If there is a hand of that id.
        """
        contents = read_files(files)
        answer: hand_service_pb2.CreateHandResponse = self._unary(
            lambda left: self._hands.CreateHand.future(
                upload(id, contents, validate_only), timeout=left, metadata=self._metadata
            ),
            timeout,
            NEVER,
        )
        return created_from_wire(answer)

    def delete_hand(self, hand: HandLike, *, timeout: float | None = None) -> None:
        """Removes a hand that was created; never repeated.

        Raises:
            FailedPreconditionError: For a hand that comes with the server.
            NotFoundError: If there is no such hand.
        """
        request = hand_service_pb2.DeleteHandRequest(name=hand_name(hand))
        self._unary(
            lambda left: self._hands.DeleteHand.future(request, timeout=left, metadata=self._metadata),
            timeout,
            NEVER,
        )

    # --- calls ---

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
        raise _from_rpc(error) from None
    except BaseException:
        call.cancel()
        raise


def _from_rpc(error: grpc.RpcError) -> CallError:
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
            raise _from_rpc(error) from None

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
