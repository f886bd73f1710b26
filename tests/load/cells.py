#!/usr/bin/env python3
"""Several cells against one server: whether servo streams keep their rate while sorting cells plan. Needs a release build.

Servo streams (frames of 224 x 172, the stand-in for palm cameras) run alone, then beside sorting cells, which take
frames, plan for three hands and sort trays until the streams have been measured. The cells, whose worlds are simulated,
stand for other machines: they run nicer than the server (--nice). On a machine that others use too, --server-nice -10
(as root) gives server and cameras the cores first. Printed are, for each stream, answers a second, ages of answers and gaps
between them, and how long the sorting cells waited for their plans.

    tests/load/cells.py target/release/graspd out.json --streams 1 --rate 30 --cells 2 --seconds 60
"""

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SORT = Path(__file__).resolve().parents[2] / "examples" / "sort.toml"
# What the streams are to keep: answers a second (or the camera's rate, where that is lower), and p99 of the gaps.
LEAST_RATE, MOST_GAP_MS = 30.0, 80.0


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def serve(graspd, nice, metrics, flags):
    port = free_port()
    command = ["nice", "-n", str(nice), graspd, "serve", "--listen", f"127.0.0.1:{port}", "--metrics-listen", f"127.0.0.1:{metrics}", *flags]
    server = subprocess.Popen(command, env={**os.environ, "RUST_LOG": "error"})
    for _ in range(400):
        with socket.socket() as s:
            if s.connect_ex(("127.0.0.1", port)) == 0:
                return server, f"http://127.0.0.1:{port}"
        time.sleep(0.05)
    server.kill()
    sys.exit("the server does not listen")


def calls(metrics):
    """Answered plans for several hands, as the server counts them."""
    with socket.create_connection(("127.0.0.1", metrics), timeout=10) as s:
        s.sendall(b"GET /metrics HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
        text = b"".join(iter(lambda: s.recv(65536), b"")).decode()
    lines = [line for line in text.splitlines() if line.startswith("graspd_calls_total{") and "PlanMultiHand" in line]
    return sum(float(line.rsplit(" ", 1)[1]) for line in lines)


def quantile(values, q):
    values = sorted(values)
    return values[min(len(values) - 1, int(q * len(values)))] if values else float("nan")


class Cell:
    """A sorting cell that goes from tray to tray until it is told to end."""

    def __init__(self, args, url, number, folder):
        self.args, self.url, self.number, self.folder, self.round = args, url, number, folder, 0
        self.reports, self.process, self.out = [], None, None
        self.begin()

    def begin(self):
        seed = 1000 * (self.number + 1) + self.round
        self.round += 1
        self.out = open(Path(self.folder) / f"cell-{self.number}-{self.round}.json", "w+")
        command = ["nice", "-n", str(self.args.nice), self.args.graspd, "cell", "run", str(SORT), "--server", self.url]
        command += ["--scene-seed", str(seed), "--json"]
        self.process = subprocess.Popen(command, stdout=self.out, stderr=subprocess.DEVNULL)

    def look(self):
        if self.process.poll() is not None:
            self.read()
            self.begin()

    def read(self):
        self.out.seek(0)
        text = self.out.read()
        self.out.close()
        if text.strip():
            self.reports.append(json.loads(text))

    def end(self, patience_s):
        """Lets the last tray be finished, so that its plans are counted."""
        try:
            self.process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.read()

    def plan_ms(self):
        found = []

        def walk(value):
            if isinstance(value, dict):
                for key, inner in value.items():
                    if key == "plan_s" and isinstance(inner, list):
                        found.extend(1e3 * s for s in inner)
                    else:
                        walk(inner)
            elif isinstance(value, list):
                for inner in value:
                    walk(inner)

        walk(self.reports)
        return found


def streams(args, url, cells):
    """Streams for as long as asked for; the cells are kept going."""
    command = ["nice", "-n", str(args.server_nice), args.graspd, "load", "--server", url, "--json", "--sizes", "224x172"]
    command += ["--servo", str(args.streams), "--servo-rate", str(args.rate), "--hands", args.hand]
    command += ["--warmup", "3", "--duration", str(args.seconds), "--connections", str(max(1, args.streams))]
    load = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    while load.poll() is None:
        for cell in cells:
            cell.look()
        time.sleep(0.2)
    if load.returncode != 0:
        sys.exit("the streams ended with a fault")
    return json.loads(load.stdout.read())["servo"]


def told(name, found, rate):
    for number, s in enumerate(found):
        age, gap = s["answered"], s["gaps"]
        keeps = s["answers_per_s"] >= 0.98 * min(LEAST_RATE, rate) and gap["p99_ms"] <= MOST_GAP_MS
        print(
            f"| {name} | {number} | {s['frames']} | {s['answers_per_s']:.1f} | {age['p50_ms']:.1f} | {age['p99_ms']:.1f} "
            f"| {gap['p50_ms']:.1f} | {gap['p99_ms']:.1f} | {gap['max_ms']:.0f} | {'yes' if keeps else 'no'} |"
        )
        for reason, count in s["broken"].items():
            print(f"  {count} streams ended: {reason}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("graspd", help="the binary, for example target/release/graspd")
    parser.add_argument("out", help="everything, as JSON")
    parser.add_argument("--streams", type=int, default=1, help="servo streams (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=30.0, help="frames a second of each (default: %(default)s)")
    parser.add_argument("--cells", type=int, default=2, help="sorting cells (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each measurement (default: %(default)s)")
    parser.add_argument("--hand", default="robotiq-3f", help="of the streams (default: %(default)s)")
    parser.add_argument("--nice", type=int, default=10, help="of the sorting cells (default: %(default)s)")
    parser.add_argument("--server-nice", type=int, default=0, help="of server and cameras (default: %(default)s)")
    parser.add_argument("--serve", default="", help="more flags for the server, in one word")
    args = parser.parse_args()
    metrics = free_port()
    server, url = serve(args.graspd, args.server_nice, metrics, args.serve.split())
    cells = []
    with tempfile.TemporaryDirectory(prefix="graspd-cells-") as folder:
        try:
            print("| | stream | frames | answers/s | age p50 | p99 | gap p50 | p99 | longest, ms | keeps its rate |")
            print("|---|---:|---:|---:|---:|---:|---:|---:|---:|---|")
            alone = streams(args, url, [])
            told("alone", alone, args.rate)
            cells = [Cell(args, url, number, folder) for number in range(args.cells)]
            before = calls(metrics)
            beside = streams(args, url, cells)
            planned = calls(metrics) - before
            told(f"beside {args.cells} sorting cells", beside, args.rate)
            for cell in cells:
                cell.end(120)
            waits = [cell.plan_ms() for cell in cells]
            for number, own in enumerate(waits):
                print(f"cell {number}: {len(own)} looks, plan p50 {quantile(own, 0.5):.0f} ms, p99 {quantile(own, 0.99):.0f} ms")
            print(f"{planned:.0f} plans for three hands while the streams were measured; load average {os.getloadavg()[0]:.1f}")
            found = {"arguments": vars(args), "alone": alone, "beside": beside, "plan_ms": waits, "plans": planned}
            Path(args.out).write_text(json.dumps(found))
        finally:
            for cell in cells:
                if cell.process.poll() is None:
                    cell.process.kill()
            server.terminate()
            server.wait()
    if cells and planned == 0:
        sys.exit("the sorting cells did not plan")


main()
