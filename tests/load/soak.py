#!/usr/bin/env python3
"""Soak: hours of mixed calls with drops and streams against one server that records; memory and open files are watched.

Every minute a line: goodput, resident memory, open files, bytes of the recording. Ends with 1 if memory grows by more
than a tenth (and 32 MiB) between the first quarter and the last, if files are left open, if the recording leaves its
budget, if a call fails otherwise than by load, or if the server dies.

    tests/load/soak.py target/release/graspd --hours 8 --rate 2
"""

import argparse
import json
import os
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

BUDGET_MIB = 256
# What a loaded server may say, and what a caller does to itself.
EXPECTED = {"OK", "RESOURCE_EXHAUSTED", "DEADLINE_EXCEEDED", "CANCELLED"}


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def resident_mib(pid):
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    sys.exit("no memory figure")


def open_files(pid):
    return len(os.listdir(f"/proc/{pid}/fd"))


def codes(metrics_port):
    """Calls by how they ended, as the server counts them."""
    with socket.create_connection(("127.0.0.1", metrics_port), timeout=10) as s:
        s.sendall(b"GET /metrics HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
        text = b"".join(iter(lambda: s.recv(65536), b"")).decode()
    found = {}
    for line in text.splitlines():
        if line.startswith("graspd_calls_total{"):
            code = line.split('code="')[1].split('"')[0]
            found[code] = found.get(code, 0) + float(line.rsplit(" ", 1)[1])
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("graspd", help="the binary, for example target/release/graspd")
    parser.add_argument("--hours", type=float, default=8.0, help="how long (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=2.0, help="calls a second (default: %(default)s)")
    args = parser.parse_args()
    graspd, hours, rate = args.graspd, args.hours, str(args.rate)
    folder = tempfile.mkdtemp(prefix="graspd-soak-")
    port, metrics = free_port(), free_port()
    serve = [graspd, "serve", "--listen", f"127.0.0.1:{port}", "--metrics-listen", f"127.0.0.1:{metrics}"]
    serve += ["--record", folder, "--record-budget", f"{BUDGET_MIB}MiB"]
    server = subprocess.Popen(serve, env={**os.environ, "RUST_LOG": "warn"})
    load = [graspd, "load", "--server", f"http://127.0.0.1:{port}", "--rate", rate, "--duration", "50", "--json"]
    load += ["--hands", "robotiq-2f85=3,leap,allegro", "--priorities", "low,normal=3,high,servo"]
    load += ["--sizes", "640x480,320x240", "--drop", "0.1", "--stream", "0.3", "--deadline-ms", "2000"]
    rows, faults = [], []
    try:
        end = time.time() + hours * 3600
        while time.time() < end and not faults:
            done = subprocess.run(load, capture_output=True, text=True)
            if server.poll() is not None:
                faults.append(f"the server ended with {server.returncode}")
                break
            if done.returncode != 0:
                faults.append(done.stderr.strip())
            # What was dropped goes; then the server is at rest.
            time.sleep(5)
            used = sum(path.stat().st_size for path in Path(folder).glob("*.mcap")) / (1 << 20)
            row = (resident_mib(server.pid), open_files(server.pid), used)
            rows.append(row)
            goodput = json.loads(done.stdout).get("goodput_per_s") if done.returncode == 0 else None
            print(f"{len(rows):5d} min  {goodput} calls/s  {row[0]:.0f} MiB  {row[1]} files  {used:.0f} MiB recorded", flush=True)
            if used > BUDGET_MIB:
                faults.append(f"the recording has {used:.1f} MiB")
            wrong = {code: n for code, n in codes(metrics).items() if code not in EXPECTED}
            if wrong:
                faults.append(f"calls ended with {wrong}")
        if len(rows) >= 8:
            quarter = len(rows) // 4
            first, last = rows[:quarter], rows[-quarter:]
            before, after = (statistics.median(r[0] for r in part) for part in (first, last))
            if after > before * 1.1 + 32:
                faults.append(f"memory grew from {before:.0f} to {after:.0f} MiB")
            if min(r[1] for r in last) > max(r[1] for r in first) + 4:
                faults.append(f"{last[-1][1]} files are open, {first[0][1]} were")
        elif not faults:
            print("too short to judge memory: at least 8 minutes")
    finally:
        server.terminate()
        server.wait()
        shutil.rmtree(folder, ignore_errors=True)
    print("\n".join(faults) if faults else f"sound after {len(rows)} minutes")
    sys.exit(bool(faults))


main()
