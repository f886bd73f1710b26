"""A broker, two fronts, a worker and Envoy before them, as processes with the configurations of deploy/: under load one front
after the other is killed and started again, and then the worker. No call fails."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

from common import DEPLOY, GRASPD, clean_environment

BIN = Path(sys.executable).parent
PATIENCE_S = 120
SECONDS = 40


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Process:
    """A process whose output is kept; killed at the end."""

    def __init__(self, command: list, environment: dict | None = None):
        self.log: list[str] = []
        env = clean_environment() | (environment or {})
        self.child = subprocess.Popen(
            [str(c) for c in command], env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self.child.stdout:
            self.log.append(line.rstrip())

    def wait_for(self, text: str) -> "Process":
        due = time.monotonic() + PATIENCE_S
        while not any(text in line for line in self.log):
            assert self.child.poll() is None and time.monotonic() < due, "\n".join([f"no {text!r} in", *self.log[-40:]])
            time.sleep(0.05)
        return self

    def kill(self) -> None:
        if self.child.poll() is None:
            self.child.send_signal(signal.SIGKILL)
        self.child.wait()


def envoy_settings(fronts: list[int], port: int, admin: int, folder: Path) -> Path:
    """deploy/envoy.yaml with addresses of this machine, and a door for its counters."""
    text = (DEPLOY / "envoy.yaml").read_text()
    text, n = re.subn(r"address: 0\.0\.0\.0, port_value: 50050", f"address: 127.0.0.1, port_value: {port}", text)
    assert n == 1
    line = re.search(r"^( *)- endpoint: .*front, port_value: 50051.*$", text, re.M)
    assert line
    endpoints = [line[0].replace("front", "127.0.0.1").replace("50051", str(p)) for p in fronts]
    text = text.replace(line[0], "\n".join(endpoints))
    text += f"admin: {{address: {{socket_address: {{address: 127.0.0.1, port_value: {admin}}}}}}}\n"
    path = folder / "envoy.yaml"
    path.write_text(text)
    return path


def counter(admin: int, name: str) -> int:
    with urllib.request.urlopen(f"http://127.0.0.1:{admin}/stats?filter={name}", timeout=20) as answer:
        lines = answer.read().decode().splitlines()
    return sum(int(line.rsplit(" ", 1)[1]) for line in lines if line.split(":")[0].endswith(name))


def told(report: dict, admin: int, processes: dict[str, Process]) -> str:
    """What went wrong, and what Envoy and the others have to say of it."""
    with urllib.request.urlopen(f"http://127.0.0.1:{admin}/stats?filter=upstream_rq_&usedonly", timeout=20) as answer:
        counters = answer.read().decode()
    logs = [f"{name}: {line}" for name, process in processes.items() for line in process.log[-20:]]
    return "\n".join([f"{report['codes']} {report.get('messages')}", counters, *logs])


def check() -> str:
    # The file as it is, before anything in it is changed.
    done = subprocess.run(
        [BIN / "envoy", "--mode", "validate", "-c", DEPLOY / "envoy.yaml"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    with tempfile.TemporaryDirectory() as name:
        return under_load(Path(name))


def under_load(folder: Path) -> str:
    broker_port, envoy_port, admin = free_port(), free_port(), free_port()
    fronts = [free_port(), free_port()]
    settings = (DEPLOY / "nats.conf").read_text()
    settings = settings.replace("127.0.0.1:4222", f"127.0.0.1:{broker_port}").replace("/var/lib/nats", str(folder))
    (folder / "nats.conf").write_text(settings)
    engine = {"GRASPD_ENGINE": f"nats://127.0.0.1:{broker_port}"}
    processes: dict[str, Process] = {}

    def front(i: int) -> Process:
        command = [GRASPD, "serve", "--listen", f"127.0.0.1:{fronts[i]}", "--threads", "1"]
        return Process(command, engine)

    def worker() -> Process:
        return Process([GRASPD, "worker", "--threads", "1"], engine)

    try:
        processes["broker"] = Process([BIN / "nats-server", "-c", folder / "nats.conf"]).wait_for("Server is ready")
        processes["worker"] = worker().wait_for("working")
        for i in range(2):
            processes[f"front {i}"] = front(i).wait_for("local_addr=")
        path = envoy_settings(fronts, envoy_port, admin, folder)
        processes["envoy"] = Process([BIN / "envoy", "-c", path, "--base-id", os.getpid() % 30000, "-l", "warn"])
        due = time.monotonic() + PATIENCE_S
        while True:
            try:
                if counter(admin, "membership_healthy") == 2:
                    break
            except OSError:
                pass
            assert time.monotonic() < due, "\n".join(processes["envoy"].log[-40:])
            time.sleep(0.1)
        load = subprocess.Popen(
            [GRASPD, "load", "--server", f"http://127.0.0.1:{envoy_port}", "--concurrency", "4", "--duration", str(SECONDS),
             "--warmup", "0", "--deadline-ms", "60000", "--scheme", "20,10", "--batch", "8", "--json"],
            env=clean_environment(), stdout=subprocess.PIPE, text=True,
        )
        for _ in range(2):
            for i in range(2):
                time.sleep(SECONDS / 8)
                processes[f"front {i}"].kill()
                processes[f"front {i}"] = front(i).wait_for("local_addr=")
                # The other one is killed when this one takes calls again.
                due = time.monotonic() + PATIENCE_S
                while counter(admin, "membership_healthy") < 2:
                    assert time.monotonic() < due, "a front that was started again is not healthy"
                    time.sleep(0.1)
        processes["worker"].kill()
        processes["worker"] = worker()
        out, _ = load.communicate(timeout=SECONDS + PATIENCE_S)
        assert load.returncode == 0, out
        report = json.loads(out)
        assert report["calls"] >= SECONDS // 2 and set(report["codes"]) == {"OK"}, told(report, admin, processes)
        retried, abandoned = counter(admin, "upstream_rq_retry"), counter(admin, "retry_or_shadow_abandoned")
        assert abandoned == 0, f"{abandoned} calls were too large to be repeated"
        return f"{report['calls']} calls while fronts and worker were killed, none failed ({retried} repeated by Envoy)"
    finally:
        for process in processes.values():
            process.kill()
