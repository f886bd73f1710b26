"""Rules that need no server: errors and their details, retries, versions, addresses, stubs, docstrings."""

from __future__ import annotations

import doctest
import importlib
import importlib.util
import pickle
import pkgutil
import re
import sys
from datetime import timedelta
from pathlib import Path

import grpc
import pytest
from google.protobuf.any_pb2 import Any
from google.protobuf.message import Message
from google.rpc import code_pb2, error_details_pb2, status_pb2

import graspd
from graspd.connection import Settings
from graspd.errors import CallError, call_error, code_of, from_status
from graspd.retry import NEVER, Attempts, RetryPolicy
from graspd.versions import check

HERE = Path(__file__).resolve().parent
UNAVAILABLE = call_error(grpc.StatusCode.UNAVAILABLE, "gone")


def packed(*details: Message) -> list[tuple[str, bytes]]:
    status = status_pb2.Status()
    for detail in details:
        wrapped = Any()
        wrapped.Pack(detail)
        status.details.append(wrapped)
    return [("grpc-status-details-bin", status.SerializeToString())]


def test_details_become_fields() -> None:
    retry = error_details_pb2.RetryInfo()
    retry.retry_delay.FromTimedelta(timedelta(milliseconds=20))
    bad = error_details_pb2.BadRequest()
    bad.field_violations.add(field="frames[0].data", description="found 1 bytes")
    info = error_details_pb2.ErrorInfo(reason="QUEUE_FULL", domain="graspd.dev", metadata={"limit": "4"})
    error = from_status(grpc.StatusCode.RESOURCE_EXHAUSTED, "full", packed(info, retry, bad))
    assert isinstance(error, graspd.ResourceExhaustedError)
    assert (error.reason, error.retry_after, error.metadata) == ("QUEUE_FULL", 0.02, {"limit": "4"})
    assert error.violations == (graspd.Violation("frames[0].data", "found 1 bytes"),)
    assert error.fields == ("frames[0].data",)
    assert str(error) == "QUEUE_FULL: full"


def test_a_status_without_details_or_with_garbage_is_understood() -> None:
    for trailing in (None, [], [("grpc-status-details-bin", b"\xff\xff\xff")], [("other", "x")]):
        error = from_status(grpc.StatusCode.UNAVAILABLE, "gone", trailing)
        assert isinstance(error, graspd.UnavailableError) and (error.reason, error.retry_after) == ("", None)
    late = from_status(grpc.StatusCode.DEADLINE_EXCEEDED, "Deadline Exceeded", None)
    assert isinstance(late, TimeoutError) and late.reason == "DEADLINE_EXCEEDED"


def test_errors_are_what_python_calls_them() -> None:
    kinds = {
        grpc.StatusCode.INVALID_ARGUMENT: ValueError,
        grpc.StatusCode.NOT_FOUND: LookupError,
        grpc.StatusCode.DEADLINE_EXCEEDED: TimeoutError,
        grpc.StatusCode.UNAVAILABLE: ConnectionError,
        grpc.StatusCode.PERMISSION_DENIED: PermissionError,
    }
    for code in grpc.StatusCode:
        error = call_error(code, "text", reason="R", retry_after=1.0, metadata={"a": "b"})
        assert isinstance(error, kinds.get(code, Exception)) and isinstance(error, graspd.GraspdError)
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is type(error) and str(again) == "R: text"
        assert (again.code, again.retry_after, again.metadata) == (code, 1.0, {"a": "b"})
        assert code_of(code.value[0]) is code
    assert {code.value[0] for code in grpc.StatusCode} == set(code_pb2.Code.values())
    assert code_of(99) is grpc.StatusCode.UNKNOWN


def test_only_what_is_documented_is_repeated() -> None:
    policy = RetryPolicy()
    for code in grpc.StatusCode:
        repeated = policy.wait(call_error(code, ""), 1, 0.5) is not None
        assert repeated == (code is grpc.StatusCode.UNAVAILABLE), code
    full = call_error(grpc.StatusCode.RESOURCE_EXHAUSTED, "", retry_after=0.04)
    assert policy.wait(full, 1, 0.0) == 0.04
    assert policy.wait(full, 1, 1.0) == pytest.approx(0.06)
    assert policy.wait(UNAVAILABLE, 4, 0.0) is None
    assert NEVER.wait(UNAVAILABLE, 1, 0.0) is None


def test_back_off_grows_and_is_bounded() -> None:
    policy = RetryPolicy(attempts=40)
    waits = [policy.wait(UNAVAILABLE, n, 1.0) for n in range(1, 40)]
    assert waits[0] == 0.05 and waits[-1] == policy.longest_backoff
    assert waits == sorted(w for w in waits if w is not None)
    asked = call_error(grpc.StatusCode.UNAVAILABLE, "", retry_after=3.0)
    assert policy.wait(asked, 1, 0.0) == 3.0
    for wrong in ({"attempts": 0}, {"first_backoff": -1.0}, {"first_backoff": 2.0}):
        with pytest.raises(ValueError, match="expected"):
            RetryPolicy(**wrong)


def test_the_deadline_holds_for_all_attempts_together() -> None:
    attempts = Attempts(RetryPolicy(attempts=1000, first_backoff=0.05), timeout=0.04)
    asked = call_error(grpc.StatusCode.UNAVAILABLE, "", retry_after=0.05)
    with pytest.raises(CallError) as caught:
        attempts.after(asked)
    assert caught.value is asked


@pytest.mark.parametrize(
    ("client", "server", "fits"),
    [
        ("0.1.0", "0.1.0", True),
        ("0.1.7", "0.1.0", True),
        ("0.1.0", "0.1.3-rc.1", True),
        ("0.2.0", "0.1.9", False),
        ("0.1.0", "0.2.0", False),
        ("0.9.0", "1.0.0", False),
        ("1.2.0", "1.2.5", True),
        ("1.2.0", "1.7.0", True),
        ("1.7.0", "1.2.0", False),
        ("2.0.0", "1.9.0", False),
        ("1.9.0", "2.0.0", False),
        ("0.1.0", "unknown", False),
    ],
)
def test_versions_that_fit(client: str, server: str, fits: bool) -> None:
    if fits:
        check(server, "host:1", client)
        return
    with pytest.raises(graspd.VersionError) as caught:
        check(server, "host:1", client)
    said = str(caught.value)
    assert client in said and server in said and "host:1" in said
    if server[0].isdigit():
        assert f"pip install 'graspd=={'.'.join(server.split('.')[:2])}.*'" in said


def test_the_client_is_of_the_servers_version() -> None:
    cargo = (HERE.parents[2] / "Cargo.toml").read_text()
    found = re.search(r'^version = "(.*)"', cargo, re.MULTILINE)
    assert found and found[1] == graspd.__version__


def test_the_licences_are_the_repositorys() -> None:
    # Copies: archives of sources cannot link to what is outside of them.
    for name in ("LICENSE-MIT", "LICENSE-APACHE"):
        assert (HERE.parent / name).read_bytes() == (HERE.parents[2] / name).read_bytes()


def test_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    def target(address: str | None, **more: object) -> tuple[str, bool]:
        resolved = Settings(address=address, **more).resolved()  # type: ignore[arg-type]
        return resolved.address, resolved.tls is not None

    monkeypatch.delenv("GRASPD_ADDRESS", raising=False)
    assert target(None) == ("127.0.0.1:50051", False)
    monkeypatch.setenv("GRASPD_ADDRESS", "http://cell:7")
    assert target(None) == ("cell:7", False)
    assert target("https://cell:7/") == ("cell:7", True)
    assert target("[::1]:7") == ("[::1]:7", False)
    assert target("cell:7", tls=graspd.Tls()) == ("cell:7", True)
    for wrong in ("cell", ":7", "cell:x", "ftp://cell:7"):
        with pytest.raises(ValueError, match="address: found"):
            target(wrong)
    with pytest.raises(ValueError, match="with tls"):
        target("http://cell:7", tls=graspd.Tls())
    with pytest.raises(ValueError, match="timeout: found 0"):
        target(None, timeout=0)


def test_tokens_do_not_travel_in_the_clear() -> None:
    for own in ("localhost:7", "127.0.0.2:7", "[::1]:7", "https://cell:7"):
        Settings(address=own, token="secret").resolved()
    with pytest.raises(ValueError, match="token: found one") as caught:
        Settings(address="cell:7", token="secret").resolved()
    assert "secret" not in str(caught.value)
    with pytest.raises(ValueError, match="expected both or neither"):
        graspd.Tls(certificate="client.pem").credentials()


def test_the_stubs_are_what_the_protocol_gives() -> None:
    spec = importlib.util.spec_from_file_location("generate", HERE.parent / "generate.py")
    assert spec and spec.loader
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    assert generate.differences() == []


def test_docstrings_are_true() -> None:
    names = [m.name for m in pkgutil.walk_packages(graspd.__path__, "graspd.") if ".v1" not in m.name]
    assert len(names) > 15
    counts = [doctest.testmod(importlib.import_module(name)) for name in [*names, "graspd"]]
    assert sum(c.failed for c in counts) == 0
    assert sum(c.attempted for c in counts) >= 4


def test_nothing_but_the_extras_needs_the_extras() -> None:
    # A fresh interpreter: this one has imported them all.
    import subprocess

    code = (
        "import sys, graspd, graspd.aio, graspd.convert.ros;"
        "print([m for m in ('scipy', 'trimesh', 'matplotlib', 'rerun') if m in sys.modules])"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"
