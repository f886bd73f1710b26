#!/usr/bin/env python3
"""Overload: goodput at several times the capacity, beside a plain FIFO's. Needs a release build of graspd.

For each factor the capacity is measured anew right before (closed loop, the scheduler's server), so that a shared
machine's other load falls on both sides of each ratio. Prints a table and writes JSON.

    tests/load/overload.py target/release/graspd out.json [seconds of each run] [deadline, ms]
"""

import json
import os
import socket
import subprocess
import sys
import time

FACTORS = [0.5, 1.0, 1.5, 2.0, 4.0]
COMMON = "--scheme 200,40 --batch 48 --require-complete --warmup 2 --json --connections 4".split()


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Server:
    def __init__(self, graspd, *flags):
        self.url = f"http://127.0.0.1:{free_port()}"
        env = {**os.environ, "RUST_LOG": "error"}
        args = [graspd, "serve", "--listen", self.url[7:], "--queue", "64", *flags]
        self.process = subprocess.Popen(args, env=env, stderr=subprocess.DEVNULL)
        for _ in range(200):
            with socket.socket() as s:
                if s.connect_ex(("127.0.0.1", int(self.url.rsplit(":", 1)[1]))) == 0:
                    return
            time.sleep(0.05)
        sys.exit("the server does not listen")

    def load(self, graspd, seconds, deadline, *flags):
        args = [graspd, "load", "--server", self.url, "--duration", str(seconds), "--deadline-ms", str(deadline)]
        done = subprocess.run([*args, *COMMON, *flags], capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(done.stderr)
        return json.loads(done.stdout)

    def end(self):
        self.process.terminate()
        self.process.wait()


def main():
    graspd, out = sys.argv[1], sys.argv[2]
    seconds = float(sys.argv[3]) if len(sys.argv) > 3 else 12
    deadline = int(sys.argv[4]) if len(sys.argv) > 4 else 1000
    ours, fifo = Server(graspd), Server(graspd, "--plain-fifo")
    rows = []
    try:
        ours.load(graspd, 3, 60000, "--concurrency", "4")
        for factor in FACTORS:
            capacity = ours.load(graspd, 5, 60000, "--concurrency", "4")["goodput_per_s"]
            row = {"factor": factor, "capacity_per_s": capacity, "load_average": os.getloadavg()[0]}
            for name, server in [("scheduler", ours), ("fifo", fifo)]:
                run = server.load(graspd, seconds, deadline, "--rate", str(capacity * factor))
                for key in ["answered", "refused"]:
                    run[key].pop("hdr_v2_base64_us")
                run.pop("answered_by_priority")
                row[name] = run
                time.sleep(deadline / 1000)
            rows.append(row)
            s, f = row["scheduler"], row["fifo"]
            print(
                f"{factor:>4}x of {capacity:5.1f}/s: "
                f"scheduler {s['goodput_per_s'] / capacity:4.2f} p99 {s['answered']['p99_ms']:6.0f} ms "
                f"refused p50 {s['refused']['p50_ms']:.1f} p99 {s['refused']['p99_ms']:.1f} ms (n {s['refused']['count']}) {s['codes']}; "
                f"fifo {f['goodput_per_s'] / capacity:4.2f} {f['codes']}; load {row['load_average']:.1f}",
                flush=True,
            )
    finally:
        ours.end()
        fifo.end()
    with open(out, "w") as file:
        json.dump({"deadline_ms": deadline, "seconds": seconds, "rows": rows}, file, indent=1)


if __name__ == "__main__":
    main()
