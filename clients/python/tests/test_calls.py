"""Calls against real servers that are slow, full, gone or back: deadlines, cancellation, retries, connecting."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import graspd
from graspd.requests import chosen_id, plan_request
from tests.conftest import LONG, MUCH, SOON, Server

ONCE = graspd.RetryPolicy(attempts=1)


def seconds_of_work(server: Server) -> float:
    """Processor time that the server has used so far."""
    fields = Path(f"/proc/{server.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def answers_soon(server: Server, frame: graspd.DepthFrame) -> None:
    """Passes when the server soon stops working, and then answers."""
    began = time.monotonic()
    while True:
        before = seconds_of_work(server)
        time.sleep(0.3)
        if seconds_of_work(server) - before < 0.05:
            break
        assert time.monotonic() - began < SOON, "the server goes on working for nobody"
    with graspd.connect(server.address, timeout=SOON) as planner:
        assert len(planner.plan(frame, hand="robotiq-2f85")) > 0


def test_a_deadline_ends_the_work(small_server: Server, frame: graspd.DepthFrame) -> None:
    with graspd.connect(small_server.address) as planner:
        began = time.monotonic()
        plan = planner.plan(frame, hand="leap", options=MUCH, timeout=6)
        # The best so far came in time.
        assert plan.stats.budget_exhausted and time.monotonic() - began < 9
        # Too late, or refused at once because it would be.
        with pytest.raises((graspd.DeadlineExceededError, graspd.ResourceExhaustedError)) as caught:
            planner.plan(frame, hand="leap", options=LONG, timeout=0.004)
        assert caught.value.reason in ("DEADLINE_EXCEEDED", "CANNOT_FINISH")
        with pytest.raises(TimeoutError):
            planner.plan(frame, hand="leap", timeout=-1.0)
    answers_soon(small_server, frame)


def test_a_budget_is_kept(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    options = graspd.PlanOptions(batch_size=4096, scheme=(10000, 10000), budget=0.7)
    began = time.monotonic()
    plan = planner.plan(frame, hand="leap", options=options, timeout=60)
    assert plan.stats.budget_exhausted and time.monotonic() - began < SOON


def test_another_thread_cancels(small_server: Server, frame: graspd.DepthFrame) -> None:
    with graspd.connect(small_server.address, timeout=300) as planner:
        for ask in (
            lambda switch: planner.plan(frame, hand="leap", options=LONG, cancellation=switch),
            lambda switch: planner.plan_hands(frame, hands=["leap", "panda"], options=LONG, cancellation=switch),
        ):
            switch = graspd.Cancellation()
            timer = threading.Timer(0.5, switch.cancel)
            timer.start()
            began = time.monotonic()
            with pytest.raises(graspd.CancelledError):
                ask(switch)
            assert 0.4 < time.monotonic() - began < 5
            assert switch.cancelled
            with pytest.raises(graspd.CancelledError):
                ask(switch)
            answers_soon(small_server, frame)


def test_leaving_a_stream_ends_the_work(small_server: Server, frame: graspd.DepthFrame) -> None:
    with graspd.connect(small_server.address, timeout=300) as planner:
        with planner.stream(frame, hand="leap", options=LONG) as stream:
            assert isinstance(next(stream), graspd.Accepted)
        assert list(stream) == []
        answers_soon(small_server, frame)


def test_leaving_results_ends_the_work(frame: graspd.DepthFrame) -> None:
    server = Server("--slots", "2", "--threads", "1")
    try:
        with graspd.connect(server.address, timeout=300) as planner:
            results = planner.stream_hands(frame, hands={"quick": "panda", "slow": graspd.HandTask("leap", LONG)})
            assert next(results).task_id == "quick"
            results.close()  # type: ignore[attr-defined]
            answers_soon(server, frame)
    finally:
        server.stop()


def test_a_forgotten_stream_ends_the_work(small_server: Server, frame: graspd.DepthFrame) -> None:
    with graspd.connect(small_server.address, timeout=300) as planner:
        for event in planner.stream(frame, hand="leap", options=LONG):
            assert isinstance(event, graspd.Accepted)
            break
        answers_soon(small_server, frame)


INTERRUPTED = """
import graspd, signal, sys
from tests.conftest import LONG
# A shell starts programs in the background with interrupts ignored, and that is inherited.
signal.signal(signal.SIGINT, signal.default_int_handler)
with graspd.connect(sys.argv[1], timeout=300) as planner:
    print("asking", flush=True)
    try:
        planner.plan(graspd.examples.box_frame(), hand="leap", options=LONG)
    except KeyboardInterrupt:
        print("interrupted", flush=True)
        input()
"""


def test_an_interrupt_ends_the_work(small_server: Server, frame: graspd.DepthFrame) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, small_server.address],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[1],
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "asking\n"
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "interrupted\n"
        # It lives on, and its connection with it: the call has ended all the same.
        answers_soon(small_server, frame)
        process.communicate("\n", timeout=SOON)


def test_a_stream_is_cancelled_from_another_thread(small_server: Server, frame: graspd.DepthFrame) -> None:
    with graspd.connect(small_server.address, timeout=300) as planner:
        stream = planner.stream(frame, hand="leap", options=LONG)
        assert isinstance(next(stream), graspd.Accepted)
        threading.Timer(0.5, stream.cancel).start()
        with pytest.raises(graspd.CancelledError):
            for event in stream:
                assert isinstance(event, graspd.Improved)
    answers_soon(small_server, frame)


def test_closing_the_planner_ends_its_calls(small_server: Server, frame: graspd.DepthFrame) -> None:
    planner = graspd.connect(small_server.address, timeout=300)
    threading.Timer(0.5, planner.close).start()
    with pytest.raises(graspd.CallError):
        planner.plan(frame, hand="leap", options=LONG)
    answers_soon(small_server, frame)


def test_a_full_queue_says_when_to_come_back(small_server: Server, frame: graspd.DepthFrame) -> None:
    patient = graspd.RetryPolicy(attempts=200)
    with (
        graspd.connect(small_server.address, timeout=300, retry=ONCE) as planner,
        graspd.connect(small_server.address, timeout=3600, retry=patient) as other,
    ):
        # The first of two may not have begun when the second comes.
        running = [other.stream(frame, hand="leap", options=LONG) for _ in range(2)]
        for stream in running:
            assert isinstance(next(stream), graspd.Accepted)
        with pytest.raises(graspd.ResourceExhaustedError) as caught:
            planner.plan(frame, hand="robotiq-2f85")
        assert caught.value.reason == "QUEUE_FULL" and caught.value.metadata["limit"] == "1"
        assert caught.value.retry_after is not None and caught.value.retry_after > 0

        # With retries the call outlives the rush.
        def let_go() -> None:
            for stream in running:
                stream.cancel()

        threading.Timer(0.5, let_go).start()
        assert len(other.plan(frame, hand="robotiq-2f85", timeout=SOON)) > 0


def test_a_server_that_restarts_is_found_again(frame: graspd.DepthFrame) -> None:
    server = Server()
    try:
        patient = graspd.RetryPolicy(attempts=100, longest_backoff=0.2)
        with graspd.connect(server.address, timeout=SOON, retry=patient) as planner:
            assert len(planner.hands()) == 11
            server.stop()
            with pytest.raises(graspd.UnavailableError):
                planner.plan(frame, hand="panda", timeout=0.2)
            timer = threading.Timer(0.7, server.start, [server.port])
            timer.start()
            assert len(planner.plan(frame, hand="panda")) > 0
            timer.join()
    finally:
        server.stop()


def test_connecting_waits_for_a_server_that_starts_and_not_for_ever() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    began = time.monotonic()
    with pytest.raises(graspd.ConnectError, match=f"cannot connect to 127.0.0.1:{port}: .*refused"):
        graspd.connect(f"127.0.0.1:{port}", connect_timeout=0.4)
    assert time.monotonic() - began < 3
    servers: list[Server] = []
    timer = threading.Timer(0.4, lambda: servers.append(Server(port=port)))
    timer.start()
    try:
        with graspd.connect(f"http://127.0.0.1:{port}", connect_timeout=SOON) as planner:
            assert planner.server is not None and planner.server.version == graspd.__version__
            assert planner.server.estimators == ("geometric", "learned")
    finally:
        timer.join()
        servers[0].stop()


def test_one_planner_serves_many_threads(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    found: list[int] = []

    def ask() -> None:
        found.append(len(planner.plan(frame, hand="panda", options=graspd.PlanOptions(seed=1))))

    threads = [threading.Thread(target=ask) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 6 and len(set(found)) == 1 and found[0] > 0


def test_a_repetition_gets_the_answer_of_the_first(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    options = graspd.PlanOptions(seed=5, priority="high")
    first = planner.plan(frame, hand="leap", options=options, request_id="once")
    again = planner.plan(frame, hand="leap", options=options, request_id="once")
    # Durations and all: nothing was planned anew.
    assert again.message == first.message
    anew = planner.plan(frame, hand="leap", options=options)
    assert anew.message.stats.total_duration != first.message.stats.total_duration
    with pytest.raises(graspd.InvalidArgumentError) as caught:
        planner.plan(frame, hand="panda", options=options, request_id="once")
    assert caught.value.reason == "REQUEST_ID_REUSED" and caught.value.fields == ("request_id",)
    several = [planner.plan_hands(frame, hands=["leap", "panda"], request_id="both") for _ in range(2)]
    assert several[0]["panda"].get().message == several[1]["panda"].get().message


def test_attempts_of_a_call_share_an_id(frame: graspd.DepthFrame) -> None:
    ids = {chosen_id(None, graspd.RetryPolicy()) for _ in range(100)}
    assert len(ids) == 100 and all(0 < len(i) <= 128 for i in ids)
    assert chosen_id(None, ONCE) == "" and chosen_id("mine", ONCE) == "mine"
    assert plan_request(frame, None, "leap", None, None, "mine").request_id == "mine"


def test_half_an_answer_can_be_refused(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    options = graspd.PlanOptions(batch_size=4096, scheme=(10000, 10000), budget=0.5, require_complete=True)
    with pytest.raises(graspd.DeadlineExceededError):
        planner.plan(frame, hand="leap", options=options)
