"""Servo streams against a real server: frame by frame, the newest first, errors, deadlines, ends; both clients."""

from __future__ import annotations

import asyncio
import dataclasses
import threading
import time
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

import graspd
import graspd.aio
from graspd.aio_calls import within
from graspd.poses import Array
from tests.conftest import Server

START = datetime(2026, 1, 1, tzinfo=timezone.utc)
QUICK = graspd.PlanOptions(batch_size=32, seed=1)
FAST = graspd.ServoOptions(standoff_speed=0.5)
PATIENT = 120.0


def at(frame: graspd.DepthFrame, number: int) -> graspd.DepthFrame:
    """The frame as a camera that stands still takes it, twenty times a second."""
    return dataclasses.replace(frame, capture_time=START + timedelta(milliseconds=50 * number))


def moved(frame: graspd.DepthFrame, by: float) -> graspd.DepthFrame:
    assert frame.camera_pose is not None
    pose: Array = frame.camera_pose.copy()
    pose[0, 3] += by
    return dataclasses.replace(frame, camera_pose=pose)


def checked(answers: list[graspd.ServoAnswer]) -> None:
    """What holds of an approach to a box that stands still."""
    first, last = answers[0], answers[-1]
    assert (first.state, first.reason, first.standoff) == ("replanning", "first", 0.15)
    assert last.go and last.settled and last.state == "tracking" and last.reason == ""
    assert first.stages and first.age > 0 and first.capture_time == START + timedelta(milliseconds=50)
    assert last.counters.answered == len(answers) and last.counters.superseded == 0
    grasp, place = last.grasp, last.standoff_pose
    assert grasp is not None and place is not None and grasp.frame_id == "table"
    # The stand-off lies against the approach, by as much as it says.
    back = grasp.pose[:3, 3] - place[:3, 3]
    assert np.linalg.norm(back) == pytest.approx(last.standoff, abs=1e-9)
    assert np.dot(back, grasp.approach) == pytest.approx(last.standoff * np.linalg.norm(grasp.approach), rel=1e-6)
    tracked = [a for a in answers if a.state == "tracking"]
    assert tracked and all(a.change <= 0.008 + 1e-9 and a.change_angle <= 0.06 + 1e-9 for a in tracked)


def test_step_by_step_to_the_grasp(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    answers: list[graspd.ServoAnswer] = []
    with planner.servo("robotiq-2f85", servo_options=FAST, options=QUICK, answer_timeout=PATIENT) as servo:
        while not (answers and answers[-1].go) and len(answers) < 60:
            answers.append(servo.step(at(frame, len(answers) + 1)))
        assert [a.sequence for a in answers] == list(range(1, len(answers) + 1))
        servo.finish()
        assert list(servo) == []
    checked(answers)


def test_frames_and_answers_go_their_own_ways(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    sent = 40
    with planner.servo("robotiq-2f85", options=QUICK, answer_timeout=PATIENT) as servo:

        def send() -> None:
            for number in range(1, sent + 1):
                servo.send(at(frame, number))
            servo.finish()

        camera = threading.Thread(target=send)
        camera.start()
        answers = list(servo)
        camera.join()
        numbers = [a.sequence for a in answers]
        assert numbers == sorted(set(numbers)) and numbers[-1] == sent, "the newest is answered"
        counters = answers[-1].counters
        assert counters.answered == len(answers)
        # Every frame is accounted for: answered, or replaced by a newer one, here or there.
        assert counters.answered + counters.superseded + counters.shed + servo.replaced == sent


def test_what_is_refused_is_said(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    with planner.servo("robotiq-2f85", options=QUICK, answer_timeout=PATIENT) as servo:
        servo.step(at(frame, 1))
        servo.send(moved(at(frame, 2), 9.0))
        # The wild one is looked at before the next comes, or is replaced by it.
        time.sleep(0.5)
        answer = servo.step(at(frame, 3))
        assert answer.counters.wild + answer.counters.superseded + servo.replaced == 1
        if answer.counters.wild:
            assert answer.refused
    with planner.servo("robotiq-2f85") as servo:
        with pytest.raises(ValueError, match="camera_pose"):
            servo.send(dataclasses.replace(frame, camera_pose=None))
        assert servo.send(frame, sequence=5) == 5
        with pytest.raises(ValueError, match="sequence: found 5, expected more than 5"):
            servo.send(frame, sequence=5)


def test_a_wrong_option_is_named(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    with planner.servo("robotiq-2f85", servo_options=graspd.ServoOptions(standoff_start=9.0)) as servo:
        with pytest.raises(graspd.InvalidArgumentError) as caught:
            servo.step(frame)
        assert caught.value.violations[0].field == "config.standoff_start_m"
        with pytest.raises(graspd.GraspdError, match="has ended"):
            servo.send(frame)
    with planner.servo("nobody") as servo, pytest.raises(graspd.NotFoundError):
        next(servo)
    with pytest.raises(ValueError, match="mode: found 'wild'"):
        planner.servo("leap", servo_options=graspd.ServoOptions(mode="wild"))  # type: ignore[arg-type]


def test_a_hand_that_the_camera_sees_is_told(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    hand = planner.hand("robotiq-2f85")
    away = graspd.pose([0.0, 0.0, 0.5])
    posture = graspd.HandPosture(away, dict.fromkeys((joint.name for joint in hand.joints), 0.0))
    with planner.servo("robotiq-2f85", options=QUICK, answer_timeout=PATIENT) as servo:
        assert servo.step(at(frame, 1), hand=posture).grasp is not None
        # One that cannot be: a joint too many. It has no answer of its own; the next one's says why.
        servo.send(at(frame, 2), hand=graspd.HandPosture(away, [0.0] * (len(hand.joints) + 1)))
        time.sleep(0.5)
        answer = servo.step(at(frame, 3), hand=posture)
        assert answer.counters.invalid == 1 and "frame.hand.joint_positions" in answer.refused


def test_waiting_has_an_end(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    servo = planner.servo("robotiq-2f85", options=QUICK, answer_timeout=0.2)
    with servo, pytest.raises(graspd.DeadlineExceededError):
        # No frame was sent.
        next(servo)
    with planner.servo("robotiq-2f85", timeout=0.2) as servo, pytest.raises(graspd.DeadlineExceededError):
        next(servo)
    switched = planner.servo("robotiq-2f85", answer_timeout=PATIENT)
    threading.Timer(0.2, switched.cancel).start()
    with switched, pytest.raises(graspd.CancelledError):
        next(switched)


def test_leaving_gives_the_place_back(frame: graspd.DepthFrame, tmp_path_factory: pytest.TempPathFactory) -> None:
    settings = tmp_path_factory.mktemp("servo") / "graspd.toml"
    settings.write_text("[limits]\nservo_streams = 1\n")
    server = Server("--config", str(settings))
    try:
        with graspd.connect(server.address) as planner:
            first = planner.servo("robotiq-2f85", options=QUICK, answer_timeout=PATIENT)
            first.step(at(frame, 1))
            with planner.servo("robotiq-2f85") as second, pytest.raises(graspd.ResourceExhaustedError):
                next(second)
            # Nobody holds it any more.
            del first
            began = time.monotonic()
            while True:
                with planner.servo("robotiq-2f85", options=QUICK, answer_timeout=PATIENT) as third:
                    try:
                        third.step(at(frame, 1))
                        break
                    except graspd.ResourceExhaustedError:
                        assert time.monotonic() - began < PATIENT, "the place does not come back"
                        time.sleep(0.1)
    finally:
        server.stop()


def test_with_asyncio(server: Server, frame: graspd.DepthFrame) -> None:
    async def approach() -> list[graspd.ServoAnswer]:
        answers: list[graspd.ServoAnswer] = []
        async with (
            graspd.aio.connect(server.address) as planner,
            planner.servo("robotiq-2f85", servo_options=FAST, options=QUICK, answer_timeout=PATIENT) as servo,
        ):
            while not (answers and answers[-1].go) and len(answers) < 60:
                answers.append(await servo.step(at(frame, len(answers) + 1)))
            await servo.finish()
            assert [answer async for answer in servo] == []
            with pytest.raises(graspd.GraspdError, match="has ended"):
                await servo.send(frame)
        return answers

    checked(asyncio.run(approach()))


def test_asyncio_ends(server: Server, frame: graspd.DepthFrame) -> None:
    async def ends() -> None:
        async with graspd.aio.connect(server.address) as planner:
            wrong = graspd.ServoOptions(standoff_start=9.0)
            # Often: whether the frame is written before or after the refusal comes is chance.
            for _ in range(50):
                async with planner.servo("robotiq-2f85", servo_options=wrong) as servo:
                    with pytest.raises(graspd.InvalidArgumentError) as caught:
                        await servo.step(frame)
                    assert caught.value.violations[0].field == "config.standoff_start_m"
            async with planner.servo("robotiq-2f85", answer_timeout=0.2) as servo:
                with pytest.raises(graspd.DeadlineExceededError):
                    await anext(servo)
            async with planner.servo("robotiq-2f85", options=QUICK, answer_timeout=PATIENT) as servo:
                await servo.step(at(frame, 1))
                # No other frame was sent: this waits.
                task = asyncio.ensure_future(anext(servo))
                await asyncio.sleep(0.05)
                task.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await task
                with pytest.raises(graspd.GraspdError, match="has ended"):
                    await servo.send(at(frame, 2))

    asyncio.run(ends())


def test_a_cancellation_that_comes_with_the_answer_counts() -> None:
    async def body() -> None:
        for error in (None, ValueError("nobody asks")):
            answer: asyncio.Future[int] = asyncio.get_running_loop().create_future()
            task = asyncio.ensure_future(within(PATIENT, answer))
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            if error is None:
                answer.set_result(1)
            else:
                answer.set_exception(error)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
        with pytest.raises(asyncio.TimeoutError):
            await within(0.01, asyncio.sleep(PATIENT))
        assert await within(PATIENT, asyncio.sleep(0, "in time")) == "in time"

    asyncio.run(body())


def test_outcomes_are_reported(frame: graspd.DepthFrame, tmp_path_factory: pytest.TempPathFactory) -> None:
    server = Server("--record", str(tmp_path_factory.mktemp("recording")))
    try:
        with graspd.connect(server.address) as planner:
            plan = planner.plan(frame, hand="robotiq-2f85", options=QUICK, timeout=PATIENT)
            assert not planner.report_outcome(plan, 0, "lost_lifting", note="it slipped")
            assert planner.report_outcome(plan.message.plan_id, 0, "lost_lifting", note="it slipped")
            with pytest.raises(graspd.InvalidArgumentError) as caught:
                planner.report_outcome(plan, len(plan), "success")
            assert caught.value.violations[0].field == "grasp_index"
            with pytest.raises(ValueError, match="outcome: found 'well'"):
                planner.report_outcome(plan, 0, "well")  # type: ignore[arg-type]

        async def again() -> bool:
            async with graspd.aio.connect(server.address) as planner:
                return await planner.report_outcome(plan, 0, "lost_lifting", note="it slipped")

        assert asyncio.run(again())
    finally:
        server.stop()
