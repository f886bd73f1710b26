#!/usr/bin/env python3
"""Overload: goodput at several times the capacity, beside a plain FIFO's. Needs a release build of graspd.

Capacity (closed loop, four callers, the scheduler's server) is measured before and after every single run, and the mean
of both is what that run is compared with: a shared machine's other load moves both. Each factor is tried several times,
the two servers in turn; printed are medians and ranges, and everything goes into the JSON file.

Refusals are timed twice: by the callers, which share the cores with the server here, from when they send; and by the server
(its log), from the headers of a call to its refusal, with the frame read in between.

    tests/load/overload.py target/release/graspd out.json [factors, e.g. 0.5,1,1.5,2,4] [tries] [seconds of each run]
"""


import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import time

DEADLINE_MS = 1000
COMMON = "--scheme 200,40 --batch 48 --require-complete --warmup 1 --json --connections 4".split()


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Server:
    def __init__(self, graspd, *flags):
        self.url = f"http://127.0.0.1:{free_port()}"
        # One line for each call: how it ended, and after how long.
        env = {**os.environ, "RUST_LOG": "error,graspd_server::service::layer=info", "GRASPD_LOG_FORMAT": "json"}
        args = [graspd, "serve", "--listen", self.url[7:], "--queue", "64", *flags]
        self.log = tempfile.NamedTemporaryFile("r")
        with open(self.log.name, "a") as written:
            self.process = subprocess.Popen(args, env=env, stderr=written)
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

    def refusals_ms(self):
        """How long each refusal took since this was asked last, ascending."""
        lines = [json.loads(line) for line in self.log]
        return sorted(line["elapsed_ms"] for line in lines if line.get("code") == "ResourceExhausted")

    def end(self):
        self.process.terminate()
        self.process.wait()


def capacity(graspd, server):
    return server.load(graspd, 3, 60000, "--concurrency", "4")["goodput_per_s"]


def told(values, form="{:.2f}"):
    values = sorted(values)
    return f"{form} ({form} to {form})".format(statistics.median(values), values[0], values[-1])


def share(ascending, of):
    """The value that so many are not above."""
    return ascending[min(len(ascending) - 1, int(len(ascending) * of))]


def main():
    graspd, out = sys.argv[1], sys.argv[2]
    factors = [float(f) for f in (sys.argv[3] if len(sys.argv) > 3 else "0.5,1,1.5,2,4").split(",")]
    tries = int(sys.argv[4]) if len(sys.argv) > 4 else 5
    seconds = float(sys.argv[5]) if len(sys.argv) > 5 else 10
    servers = {"scheduler": Server(graspd), "fifo": Server(graspd, "--plain-fifo")}
    ours, runs = servers["scheduler"], []
    try:
        before = capacity(graspd, ours)
        for factor in factors:
            for _ in range(tries):
                for name, server in servers.items():
                    server.refusals_ms()
                    run = server.load(graspd, seconds, DEADLINE_MS, "--rate", str(max(before, 0.5) * factor))
                    inside = server.refusals_ms()
                    time.sleep(DEADLINE_MS / 1000)
                    after = capacity(graspd, ours)
                    mean = (before + after) / 2
                    for key in ["answered", "refused"]:
                        run[key].pop("hdr_v2_base64_us")
                    run.pop("answered_by_priority")
                    late = sum(n for code, n in run["codes"].items() if code.startswith("Deadline"))
                    runs.append({
                        "nominal_factor": factor, "server": name, "capacity_before_after_per_s": [before, after],
                        "factor": run["offered_per_s"] / mean, "goodput_over_capacity": run["goodput_per_s"] / mean,
                        "refused_by_the_server_ms": inside, "late_share": late / run["calls"], "load_average": os.getloadavg()[0], **run,
                    })
                    before = after
            for name in servers:
                mine = [r for r in runs if (r["nominal_factor"], r["server"]) == (factor, name)]
                column = lambda key: [r[key] for r in mine]
                refused = [r["refused"] for r in mine if r["refused"]["count"]]
                print(
                    f"{name:>9} offered {told(column('factor'))} x capacity: goodput {told(column('goodput_over_capacity'))}"
                    f", late {told(column('late_share'))}, p99 {max(r['answered']['p99_ms'] for r in mine):.0f} ms at most, refused p50 "
                    f"{told([r['p50_ms'] for r in refused], '{:.1f}') if refused else '-'} ms, p99 "
                    f"{told([r['p99_ms'] for r in refused], '{:.1f}') if refused else '-'} ms, by the server's clock p99 "
                    f"{told([share(r, 0.99) for r in column('refused_by_the_server_ms') if r], '{:.1f}') if refused else '-'} ms; load average {told(column('load_average'), '{:.1f}')}",
                    flush=True,
                )
    finally:
        for server in servers.values():
            server.end()
    with open(out, "w") as file:
        json.dump({"deadline_ms": DEADLINE_MS, "runs": runs}, file, indent=1)


if __name__ == "__main__":
    main()
