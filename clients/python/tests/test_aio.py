"""The asynchronous client against real servers: as the synchronous one, and cancelled as tasks are."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import pytest

import graspd
import graspd.aio
from tests.conftest import LONG, MUCH, SOON, Server
from tests.test_calls import ONCE, answers_soon
from tests.test_hands import IDS, LIBRARY


def run(body: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Runs a test's body in a loop of its own; what hangs is a failure."""
    asyncio.run(asyncio.wait_for(body(), 90))


def test_it_answers_as_the_synchronous_client(
    server: Server, planner: graspd.Planner, frame: graspd.DepthFrame
) -> None:
    options = graspd.PlanOptions(seed=11)
    expected = planner.plan(frame, hand="leap", options=options)

    async def body() -> None:
        async with graspd.aio.connect(server.address, timeout=60) as other:
            assert other.server is not None and other.server.version == graspd.__version__
            plan = await other.plan(frame, hand="leap", options=options)
            assert np.array_equal([g.pose for g in plan], [g.pose for g in expected])
            async with other.stream(frame, hand="leap", options=options) as stream:
                events = [event async for event in stream]
            assert isinstance(events[0], graspd.Accepted) and isinstance(events[-1], graspd.Finished)
            assert np.array_equal(events[-1].plan.best.pose, expected.best.pose)
            several = await other.plan_hands(frame, hands=["panda", "leap"], options=options)
            assert list(several) == ["panda", "leap"]
            assert np.array_equal(several["leap"].get().best.pose, expected.best.pose)
            results = [r.task_id async for r in other.stream_hands(frame, hands=["panda", "leap"])]
            assert sorted(results) == ["leap", "panda"]

            assert [hand.id for hand in await other.hands()] == IDS
            assert (await other.hand("leap")).revision == expected.stats.hand_revision
            assert (await other.hand_geometry("leap")).revision == expected.stats.hand_revision
            created = await other.create_hand("mine", LIBRARY / "antipodal")
            assert created.hand.origin == "created"
            await other.delete_hand("mine")
            with pytest.raises(graspd.NotFoundError):
                await other.delete_hand("mine")

    run(body)


def test_calls_run_beside_each_other(server: Server, frame: graspd.DepthFrame) -> None:
    async def body() -> None:
        async with graspd.aio.connect(server.address, timeout=60) as planner:
            plans = await asyncio.gather(*(planner.plan(frame, hand=hand) for hand in ["leap", "panda", "barrett"]))
            assert [plan.hand for plan in plans] == ["leap", "panda", "barrett"] and all(len(p) for p in plans)

    run(body)


def test_a_cancelled_task_ends_the_work(small_server: Server, frame: graspd.DepthFrame) -> None:
    async def body() -> None:
        async with graspd.aio.connect(small_server.address, timeout=300) as planner:

            async def listen() -> None:
                async for _ in planner.stream(frame, hand="leap", options=LONG):
                    pass

            for work in (
                lambda: planner.plan(frame, hand="leap", options=LONG),
                lambda: planner.plan_hands(frame, hands=["leap"], options=LONG),
                listen,
            ):
                task = asyncio.ensure_future(work())
                await asyncio.sleep(0.4)
                task.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await task
                await asyncio.to_thread(answers_soon, small_server, frame)
            # Python 3.10 has two of them.
            with pytest.raises((TimeoutError, asyncio.TimeoutError)):
                await asyncio.wait_for(planner.plan(frame, hand="leap", options=LONG), 0.4)
            await asyncio.to_thread(answers_soon, small_server, frame)

    run(body)


def test_leaving_a_stream_ends_the_work(small_server: Server, frame: graspd.DepthFrame) -> None:
    async def body() -> None:
        async with graspd.aio.connect(small_server.address, timeout=300) as planner:
            async with planner.stream(frame, hand="leap", options=LONG) as stream:
                assert isinstance(await anext(stream), graspd.Accepted)
            assert [event async for event in stream] == []
            await asyncio.to_thread(answers_soon, small_server, frame)
            async for event in planner.stream(frame, hand="leap", options=LONG):
                assert isinstance(event, graspd.Accepted)
                break
            await asyncio.to_thread(answers_soon, small_server, frame)

    run(body)


def test_a_scene_is_read(server: Server, planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    async def body() -> graspd.SceneReading:
        async with graspd.aio.connect(server.address, timeout=60) as it:
            return await it.read_scene(frame, max_points=1000)

    found, expected = asyncio.run(body()), planner.read_scene(frame, max_points=1000)
    assert np.array_equal(found.contact_field.contacts, expected.contact_field.contacts)
    assert np.array_equal(found.points[0], expected.points[0], equal_nan=True)


def test_deadlines_and_faults(small_server: Server, frame: graspd.DepthFrame) -> None:
    async def body() -> None:
        async with graspd.aio.connect(small_server.address, retry=ONCE) as planner:
            plan = await planner.plan(frame, hand="leap", options=MUCH, timeout=6)
            assert plan.stats.budget_exhausted
            with pytest.raises((graspd.DeadlineExceededError, graspd.ResourceExhaustedError)):
                await planner.plan(frame, hand="leap", options=LONG, timeout=0.004)
            with pytest.raises(graspd.InvalidArgumentError) as caught:
                await planner.plan(frame, hand="leap", options=graspd.PlanOptions(batch_size=5000))
            assert caught.value.fields == ("options.batch_size",)
        patient = graspd.RetryPolicy(attempts=200)
        async with (
            graspd.aio.connect(small_server.address, retry=ONCE) as planner,
            # What came before may not be gone yet, and the first of two may not have begun.
            graspd.aio.connect(small_server.address, timeout=3600, retry=patient) as other,
        ):
            running = [other.stream(frame, hand="leap", options=LONG) for _ in range(2)]
            for stream in running:
                assert isinstance(await anext(stream), graspd.Accepted)
            with pytest.raises(graspd.ResourceExhaustedError) as full:
                await planner.plan(frame, hand="leap")
            assert full.value.retry_after
            for stream in running:
                stream.cancel()

    run(body)


def test_a_server_that_restarts_is_found_again(frame: graspd.DepthFrame) -> None:
    server = Server()

    async def body() -> None:
        patient = graspd.RetryPolicy(attempts=100, longest_backoff=0.2)
        async with graspd.aio.connect(server.address, timeout=SOON, retry=patient) as planner:
            server.stop()
            with pytest.raises(graspd.UnavailableError):
                await planner.plan(frame, hand="panda", timeout=0.2)

            async def back() -> None:
                await asyncio.sleep(0.5)
                await asyncio.to_thread(server.start, server.port)

            plan, _ = await asyncio.gather(planner.plan(frame, hand="panda"), back())
            assert len(plan) > 0

    try:
        run(body)
    finally:
        server.stop()


def test_nobody_there_and_not_open() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]

    async def body() -> None:
        planner = graspd.aio.connect(f"127.0.0.1:{port}", connect_timeout=0.3)
        with pytest.raises(graspd.GraspdError, match="not open"):
            await planner.hands()
        began = time.monotonic()
        with pytest.raises(graspd.ConnectError, match="refused"):
            await planner.open()
        assert time.monotonic() - began < 3
        await planner.close()

    run(body)
