"""The asynchronous client: as `graspd.Planner`, with `await`.

Cancelling a task that waits for a call ends the work on the server.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from types import TracebackType
from typing import TypeVar

from graspd import answers, requests, versions
from graspd.aio_calls import AsyncConnection, AsyncStream, result
from graspd.aio_servo import AsyncServo
from graspd.connection import Settings, Tls
from graspd.errors import (
    CallError,
    ConnectError,
    GraspdError,
    UnavailableError,
    UnimplementedError,
    late,
)
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
from graspd.outcomes import Outcome, outcome_request
from graspd.plans import MultiPlan, Plan, PlanEvent, TaskResult
from graspd.reading import SceneReading, reading_from_wire, reading_request
from graspd.requests import Hands, Scene
from graspd.retry import NEVER, Attempts, RetryPolicy
from graspd.servo import ServoOptions, servo_config
from graspd.v1 import hand_service_pb2, info_service_pb2, planner_service_pb2

_T = TypeVar("_T")
_CONNECT_PAUSE = 0.05


def connect(
    address: str | None = None,
    *,
    timeout: float = 10.0,
    connect_timeout: float = 5.0,
    retry: RetryPolicy | None = None,
    tls: Tls | None = None,
    token: str | None = None,
    check_version: bool = True,
) -> AsyncPlanner:
    """As `graspd.connect`; the connection is made by `async with`, or by `await planner.open()`."""
    return AsyncPlanner(
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


class AsyncPlanner:
    """A connection to a server, for one event loop; use it in an `async with` block, or `open` and `close` it.

    Frames and units as in `graspd.Planner`; so are the arguments and the errors of its methods.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._target = settings.resolved()
        self.address = self._target.address
        """Where the server is."""
        self.server: versions.ServerInfo | None = None
        """What the server said about itself when the connection was made."""
        self._open: AsyncConnection | None = None

    async def __aenter__(self) -> AsyncPlanner:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def open(self) -> None:
        """Makes the connection.

        Raises:
            ConnectError: If nobody answers there.
            VersionError: If the server does not fit this client.
            CallError: If the server refuses.
        """
        if self._open is not None:
            return
        # A channel of grpc.aio belongs to the event loop that it is made in.
        self._open = AsyncConnection(self._settings)
        try:
            self.server = await self._greet()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Ends the connection; calls under way are cancelled."""
        connection, self._open = self._open, None
        if connection is not None:
            await connection.channel.close(None)

    def __repr__(self) -> str:
        return f"<graspd.AsyncPlanner at {self.address}>"

    # --- planning ---

    async def plan(
        self,
        scene: Scene,
        intrinsics: IntrinsicsLike | None = None,
        *,
        hand: HandLike,
        options: PlanOptions | None = None,
        scene_options: SceneOptions | None = None,
        request_id: str | None = None,
        timeout: float | None = None,
    ) -> Plan:
        """Plans grasps of one hand; see `graspd.Planner.plan`."""
        request = requests.plan_request(scene, intrinsics, hand, options, scene_options, self._id(request_id))
        method = self._connection.planner.PlanGrasps
        answer: planner_service_pb2.PlanGraspsResponse = await self._unary(
            lambda left: method(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
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
    ) -> AsyncStream[PlanEvent]:
        """Plans grasps of one hand and tells each better set as it is found; see `graspd.Planner.stream`."""
        request = planner_service_pb2.StreamGraspsRequest(
            plan=requests.plan_request(scene, intrinsics, hand, options, scene_options, self._id(request_id))
        )
        method = self._connection.planner.StreamGrasps
        return AsyncStream(
            lambda left: method(request, timeout=left, metadata=self._metadata),
            answers.event_from_wire,
            Attempts(self._settings.retry, self._timeout(timeout)),
        )

    async def plan_hands(
        self,
        scene: Scene,
        intrinsics: IntrinsicsLike | None = None,
        *,
        hands: Hands,
        options: PlanOptions | None = None,
        scene_options: SceneOptions | None = None,
        request_id: str | None = None,
        timeout: float | None = None,
    ) -> MultiPlan:
        """Plans grasps of several hands in one scene; see `graspd.Planner.plan_hands`."""
        request = requests.multi_hand_request(scene, intrinsics, hands, options, scene_options, self._id(request_id))
        results: list[TaskResult] = []
        summary: planner_service_pb2.MultiHandSummary | None = None
        async with self._multi_hand(request, timeout) as stream:
            async for message in stream:
                if message.WhichOneof("event") == "result":
                    results.append(answers.result_from_wire(message.result))
                else:
                    summary = message.summary
        return answers.multi_plan((t.task_id for t in request.tasks), results, summary)

    async def stream_hands(
        self,
        scene: Scene,
        intrinsics: IntrinsicsLike | None = None,
        *,
        hands: Hands,
        options: PlanOptions | None = None,
        scene_options: SceneOptions | None = None,
        request_id: str | None = None,
        timeout: float | None = None,
    ) -> AsyncIterator[TaskResult]:
        """As `plan_hands`, each hand's result as soon as it is ready."""
        request = requests.multi_hand_request(scene, intrinsics, hands, options, scene_options, self._id(request_id))
        async with self._multi_hand(request, timeout) as stream:
            async for message in stream:
                if message.WhichOneof("event") == "result":
                    yield answers.result_from_wire(message.result)

    def _multi_hand(
        self, request: planner_service_pb2.PlanMultiHandRequest, timeout: float | None
    ) -> AsyncStream[planner_service_pb2.PlanMultiHandResponse]:
        method = self._connection.planner.PlanMultiHand
        return AsyncStream(
            lambda left: method(request, timeout=left, metadata=self._metadata),
            lambda message: message,
            Attempts(self._settings.retry, self._timeout(timeout)),
        )

    def servo(
        self,
        hand: HandLike,
        *,
        servo_options: ServoOptions | None = None,
        options: PlanOptions | None = None,
        scene_options: SceneOptions | None = None,
        answer_timeout: float | None = None,
        timeout: float | None = None,
    ) -> AsyncServo:
        """Carries one grasp on from frame to frame; see `graspd.Planner.servo`."""
        config = servo_config(hand, servo_options, options, scene_options)
        method = self._connection.servo.ServoGrasp
        return AsyncServo(
            lambda: method(timeout=timeout, metadata=self._metadata), config, self._timeout(answer_timeout)
        )

    async def read_scene(
        self,
        scene: Scene,
        intrinsics: IntrinsicsLike | None = None,
        *,
        scene_options: SceneOptions | None = None,
        max_points: int = 0,
        timeout: float | None = None,
    ) -> SceneReading:
        """Reads a scene without a search for grasps; see `graspd.Planner.read_scene`."""
        request = reading_request(scene, intrinsics, scene_options, max_points)
        method = self._connection.planner.ReadScene
        answer: planner_service_pb2.ReadSceneResponse = await self._unary(
            lambda left: method(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )
        return reading_from_wire(answer)

    async def report_outcome(
        self, plan: Plan | str, grasp_index: int, outcome: Outcome, *, note: str = "", timeout: float | None = None
    ) -> bool:
        """Tells a server that records what became of a grasp; see `graspd.Planner.report_outcome`."""
        request = outcome_request(plan, grasp_index, outcome, note)
        method = self._connection.planner.ReportOutcome
        answer: planner_service_pb2.ReportOutcomeResponse = await self._unary(
            lambda left: method(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )
        return answer.repeated_report

    # --- hands ---

    async def hands(self, *, timeout: float | None = None) -> list[Hand]:
        """All hands of the server, in the order of their ids."""
        found: list[Hand] = []
        token = ""
        while True:
            page = await self._list_hands(hand_service_pb2.ListHandsRequest(page_token=token), timeout)
            found += [hand_from_wire(hand) for hand in page.hands]
            token = page.next_page_token
            if not token:
                return found

    async def _list_hands(
        self, request: hand_service_pb2.ListHandsRequest, timeout: float | None
    ) -> hand_service_pb2.ListHandsResponse:
        method = self._connection.hands.ListHands
        return await self._unary(
            lambda left: method(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )

    async def hand(self, hand: HandLike, *, timeout: float | None = None) -> Hand:
        """One hand; see `graspd.Planner.hand`."""
        request = hand_service_pb2.GetHandRequest(name=hand_name(hand))
        method = self._connection.hands.GetHand
        answer: hand_service_pb2.GetHandResponse = await self._unary(
            lambda left: method(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )
        return hand_from_wire(answer.hand)

    async def hand_geometry(self, hand: HandLike, *, timeout: float | None = None) -> HandGeometry:
        """The shape of a hand and how its parts move; see `graspd.Planner.hand_geometry`."""
        request = hand_service_pb2.GetHandGeometryRequest(name=hand_name(hand))
        method = self._connection.hands.GetHandGeometry
        answer: hand_service_pb2.GetHandGeometryResponse = await self._unary(
            lambda left: method(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )
        return geometry_from_wire(hand_id(hand), answer)

    async def create_hand(
        self, id: str, files: HandFiles, *, validate_only: bool = False, timeout: float | None = None
    ) -> CreatedHand:
        """Adds a hand from its folder or files; see `graspd.Planner.create_hand`."""
        contents = await asyncio.to_thread(read_files, files)
        method = self._connection.hands.CreateHand
        answer: hand_service_pb2.CreateHandResponse = await self._unary(
            lambda left: method(upload(id, contents, validate_only), timeout=left, metadata=self._metadata),
            timeout,
            NEVER,
        )
        return created_from_wire(answer)

    async def delete_hand(self, hand: HandLike, *, timeout: float | None = None) -> None:
        """Removes a hand that was created; see `graspd.Planner.delete_hand`."""
        request = hand_service_pb2.DeleteHandRequest(name=hand_name(hand))
        method = self._connection.hands.DeleteHand
        await self._unary(lambda left: method(request, timeout=left, metadata=self._metadata), timeout, NEVER)

    # --- calls ---

    @property
    def _connection(self) -> AsyncConnection:
        if self._open is None:
            raise GraspdError("the planner is not open: use it in an `async with` block, or await open() first")
        return self._open

    @property
    def _metadata(self) -> tuple[tuple[str, str], ...]:
        return self._settings.metadata()

    def _id(self, request_id: str | None) -> str:
        return requests.chosen_id(request_id, self._settings.retry)

    def _timeout(self, timeout: float | None) -> float:
        return self._settings.timeout if timeout is None else timeout

    async def _unary(self, start: Callable[[float], Awaitable[_T]], timeout: float | None, policy: RetryPolicy) -> _T:
        attempts = Attempts(policy, self._timeout(timeout))
        while True:
            left = attempts.left
            if left <= 0:
                raise late()
            try:
                return await result(start(left))
            except CallError as error:
                wait = attempts.after(error)
            await asyncio.sleep(wait)

    async def _greet(self) -> versions.ServerInfo | None:
        """Asks the server who it is, until it answers or the time for connecting is up."""
        deadline = time.monotonic() + self._settings.connect_timeout
        method = self._connection.info.GetServerInfo
        request = info_service_pb2.GetServerInfoRequest()
        while True:
            left = max(deadline - time.monotonic(), 0.001)
            try:
                answer: info_service_pb2.GetServerInfoResponse = await result(
                    method(request, timeout=left, metadata=self._metadata)
                )
            except UnavailableError as error:
                if time.monotonic() + _CONNECT_PAUSE >= deadline:
                    raise ConnectError(f"cannot connect to {self.address}: {error.message}") from error
                await asyncio.sleep(_CONNECT_PAUSE)
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
