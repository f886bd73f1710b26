"""Real servers for the tests: the `graspd` binary on free ports.

The binary is `$GRASPD_BIN`, or the newest one under the repository's target folder.
"""

from __future__ import annotations

import os
import re
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

import graspd

REPOSITORY = Path(__file__).resolve().parents[3]


def binary() -> Path:
    """The server's binary."""
    if named := os.environ.get("GRASPD_BIN"):
        return Path(named)
    target = Path(os.environ.get("CARGO_TARGET_DIR", REPOSITORY / "target"))
    found = [p for p in (target / "debug/graspd", target / "release/graspd") if p.is_file()]
    if not found:
        pytest.fail("no graspd binary: cargo build -p graspd, or set GRASPD_BIN")
    return max(found, key=lambda p: p.stat().st_mtime)


class Server:
    """A `graspd serve` that ends with its test."""

    def __init__(self, *arguments: str, port: int = 0) -> None:
        self.arguments = arguments
        self.address = ""
        self.start(port)

    def start(self, port: int = 0) -> None:
        """Starts it and waits until it serves."""
        command = [str(binary()), "serve", "--listen", f"127.0.0.1:{port}", "--drain-seconds", "0", *self.arguments]
        environment = {**os.environ, "NO_COLOR": "1", "RUST_LOG": "info"}
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
        )
        assert self.process.stdout is not None
        said = []
        for line in self.process.stdout:
            said.append(line)
            if found := re.search(r"local_addr=.*?(127\.0\.0\.1:\d+)", line):
                self.address = found[1]
                break
        else:
            pytest.fail(f"the server ended: {''.join(said)}")
        # Somebody has to read on: a full pipe would stop it.
        self._reader = threading.Thread(target=self._drain, args=(self.process,), daemon=True)
        self._reader.start()

    @staticmethod
    def _drain(process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        with process.stdout as said:
            for _ in said:
                pass

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self.address.rpartition(":")[2])

    def stop(self) -> None:
        """Ends it and waits."""
        self.process.terminate()
        self.process.wait(timeout=30)
        self._reader.join()


@pytest.fixture(scope="session")
def server() -> Iterator[Server]:
    """A server that all tests share."""
    it = Server()
    yield it
    it.stop()


@pytest.fixture(scope="session")
def planner(server: Server) -> Iterator[graspd.Planner]:
    """A client of it, with time enough for a loaded machine."""
    with graspd.connect(server.address, timeout=60) as it:
        yield it


@pytest.fixture
def small_server() -> Iterator[Server]:
    """A server that does one thing at a time and lets one call wait."""
    it = Server("--slots", "1", "--queue", "1", "--threads", "1")
    yield it
    it.stop()


@pytest.fixture(scope="session")
def frame() -> graspd.DepthFrame:
    """A box on a table, z up."""
    return graspd.examples.box_frame()


LONG = graspd.PlanOptions(batch_size=4096, scheme=(10000, 10000))
"""Work that takes minutes if nobody stops it."""
MUCH = graspd.PlanOptions(batch_size=512, scheme=(10000, 10000))
"""Work that a loaded machine begins within seconds, and no machine ends within them."""
SOON = 20.0
"""Seconds in which a stopped job is gone, on a loaded machine: far less than the work would take."""
