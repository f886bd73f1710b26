"""The synchronous client: planning for one hand, for several, as a stream, and from frame to frame."""

from __future__ import annotations

from collections.abc import Iterator
from types import TracebackType

from graspd import answers, requests
from graspd.calls import Stream
from graspd.cancellation import Cancellation
from graspd.connection import Settings, Tls
from graspd.frames import IntrinsicsLike
from graspd.hand_calls import HandCalls
from graspd.hands import HandLike
from graspd.options import PlanOptions, SceneOptions
from graspd.outcomes import Outcome, outcome_request
from graspd.plans import MultiPlan, Plan, PlanEvent, TaskResult
from graspd.reading import SceneReading, reading_from_wire, reading_request
from graspd.requests import Hands, Scene
from graspd.retry import Attempts, RetryPolicy
from graspd.servo import ServoOptions, servo_config
from graspd.servo_stream import Servo
from graspd.v1 import planner_service_pb2


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


class Planner(HandCalls):
    """A connection to a server. Thread-safe; close it, or use it in a `with` block.

    Poses are 4 × 4 matrices that take coordinates of the hand's root link to the world frame: the frame of
    `DepthFrame.camera_pose`, or the camera's own optical frame (x right, y down, z forward) where there is none.
    Metres, radians, seconds.
    """

    def __enter__(self) -> Planner:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<graspd.Planner at {self.address}>"

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

    def servo(
        self,
        hand: HandLike,
        *,
        servo_options: ServoOptions | None = None,
        options: PlanOptions | None = None,
        scene_options: SceneOptions | None = None,
        answer_timeout: float | None = None,
        timeout: float | None = None,
    ) -> Servo:
        """Carries one grasp on from frame to frame while the hand approaches it.

        Never repeated: a stream that breaks off is another approach.

        Args:
            hand: The hand's id, for example `"leap"`.
            servo_options: How the grasp is followed.
            options: How the first grasp is searched, and what every later one must keep to. Other defaults than in
                `plan`: 96 candidates, 48 iterations.
            scene_options: How the scene is read.
            answer_timeout: Longest wait for an answer, seconds; the connection's timeout where it is None.
            timeout: Deadline of the whole stream, seconds; None: as long as it is used.

        Returns:
            A stream: `step` or `send` frames, and iterate over the answers. Use it in a `with` block.
        """
        config = servo_config(hand, servo_options, options, scene_options)
        return Servo(
            lambda messages: self._servo.ServoGrasp(messages, timeout=timeout, metadata=self._metadata),
            config,
            self._timeout(answer_timeout),
        )

    def read_scene(
        self,
        scene: Scene,
        intrinsics: IntrinsicsLike | None = None,
        *,
        scene_options: SceneOptions | None = None,
        max_points: int = 0,
        timeout: float | None = None,
        cancellation: Cancellation | None = None,
    ) -> SceneReading:
        """Reads a scene as `plan` does, without a search for grasps: the volume, and where contacts are expected.

        Args:
            scene: As for `plan`.
            intrinsics: As for `plan`.
            scene_options: How the scene is read.
            max_points: Points of each frame that come back at most, thinned out evenly by rows and columns; 0 for none.
            timeout: Deadline of this call, seconds.
            cancellation: A switch that ends the call from another thread.

        Returns:
            The volume, the contact field, the points that the cameras saw.

        Raises:
            CallError: As for `plan`.
        """
        request = reading_request(scene, intrinsics, scene_options, max_points)
        answer: planner_service_pb2.ReadSceneResponse = self._unary(
            lambda left: self._planner.ReadScene.future(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
            cancellation,
        )
        return reading_from_wire(answer)

    def report_outcome(
        self, plan: Plan | str, grasp_index: int, outcome: Outcome, *, note: str = "", timeout: float | None = None
    ) -> bool:
        """Tells a server that records what became of a grasp; can be repeated safely, and corrected.

        Args:
            plan: The plan, or its `plan_id`.
            grasp_index: Which of its grasps, 0 for the best.
            outcome: `"success"`, or how it failed.
            note: For people, at most 1024 bytes.
            timeout: Deadline of this call, seconds.

        Returns:
            True if the same was reported before.

        Raises:
            FailedPreconditionError: If the server does not record.
            NotFoundError: If the server does not know the plan.
        """
        request = outcome_request(plan, grasp_index, outcome, note)
        answer: planner_service_pb2.ReportOutcomeResponse = self._unary(
            lambda left: self._planner.ReportOutcome.future(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )
        return answer.repeated_report
