#!/usr/bin/env python3
"""Sorting cells whose planner, network, adapters or arms fail in the middle of a run: what becomes of the objects.

    tests/sorting/failures.py target/release/graspd out.json [scenes] [scenes of emulated arms]

Every case runs `graspd cell run` once in each scene, ends something for real, and reads the cell's own account: the simulated
world's truth about every object, and collisions that its witness saw. Needs Python's standard library alone.
"""

import json
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
OBJECTS = 6


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Server:
    """`graspd serve`, which can be killed and started again on the same port."""

    def __init__(self, graspd):
        self.graspd, self.port, self.process = graspd, free_port(), None
        self.start()

    def start(self):
        command = [self.graspd, "serve", "--listen", f"127.0.0.1:{self.port}"]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        until = time.monotonic() + 60
        while time.monotonic() < until:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
                return
            except OSError:
                time.sleep(0.05)
        raise SystemExit("graspd serve does not listen")

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


class Cable:
    """A proxy whose connections can be cut, and refused until it is healed."""

    def __init__(self, port):
        self.target, self.is_cut, self.open = port, False, []
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            client, _ = self.listener.accept()
            if self.is_cut:
                client.close()
                continue
            try:
                server = socket.create_connection(("127.0.0.1", self.target))
            except OSError:
                client.close()
                continue
            self.open += [client, server]
            for a, b in ((client, server), (server, client)):
                threading.Thread(target=self.carry, args=(a, b), daemon=True).start()

    @staticmethod
    def carry(source, sink):
        try:
            while data := source.recv(65536):
                sink.sendall(data)
        except OSError:
            pass
        for s in (source, sink):
            try:
                s.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass

    def cut(self):
        self.is_cut = True
        for s in self.open:
            try:
                s.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
        self.open.clear()

    def heal(self):
        self.is_cut = False


def cell(graspd, config, scene, extra=(), at_pick=None, limit_s=400):
    """One run; `at_pick` is called when the third pick begins. Gives the account and the cell's words."""
    command = [graspd, "cell", "run", str(config), "--scene-seed", str(scene), "--objects", str(OBJECTS), "--json", *extra]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    words, picks, failing = [], 0, []

    def listen():
        nonlocal picks
        for line in process.stderr:
            words.append(line.rstrip())
            if re.search(r" takes object ", line):
                picks += 1
                if picks == 3 and at_pick:
                    failing.append(threading.Thread(target=at_pick, daemon=True))
                    failing[0].start()

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    timer = threading.Timer(limit_s, process.kill)
    timer.start()
    out = process.stdout.read()
    process.wait()
    timer.cancel()
    listener.join(5)
    # What was ended has begun again before the caller tidies up.
    for thread in failing:
        thread.join(90)
    try:
        report = json.loads(out)["report"]
    except (ValueError, KeyError):
        return {"scene": scene, "broken": f"exit {process.returncode}", "words": words[-5:]}
    truth = report["truth"]
    delivered = sum(len(v) for v in truth["delivered"].values())
    count = {name: len(truth[name] or []) for name in ("collisions", "in_hand", "in_tray", "lost", "misplaced")}
    arms = report["arms"]
    return {
        "scene": scene,
        "end": report["end"]["end"],
        "delivered": delivered,
        **count,
        "unaccounted": OBJECTS - delivered - sum(count[n] for n in ("in_hand", "in_tray", "lost", "misplaced")),
        "arms_lost": sum(a["lost"] for a in arms),
        "arms_came_back": sum(a["came_back"] for a in arms),
        "picks": picks,
        "duration_s": report["duration_s"],
    }


def with_server(graspd, server, port, scene, end, begin):
    """One run that plans over a port, behind which something ends for three seconds."""

    def fail():
        end()
        time.sleep(3)
        begin()

    try:
        return cell(graspd, EXAMPLES / "sort.toml", scene, ["--server", f"http://127.0.0.1:{port}"], fail)
    finally:
        server.kill()


def changed(folder, example, text):
    """An example with something added."""
    path = Path(folder) / example
    path.write_text((EXAMPLES / example).read_text() + "\n" + text + "\n")
    return path


def main():
    graspd, out = sys.argv[1], sys.argv[2]
    scenes = range(1, 1 + int(sys.argv[3] if len(sys.argv) > 3 else 10))
    emulated = range(1, 1 + int(sys.argv[4] if len(sys.argv) > 4 else 3))
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        def undisturbed(scene):
            return cell(graspd, EXAMPLES / "sort.toml", scene)

        def planner(scene):
            server = Server(graspd)
            return with_server(graspd, server, server.port, scene, server.kill, server.start)

        def network(scene):
            server = Server(graspd)
            cable = Cable(server.port)
            return with_server(graspd, server, cable.port, scene, cable.cut, cable.heal)

        def adapter(scene):
            config = changed(folder, "sort.toml", "[simulation.arms.back.faults.arm]\nrefused = { calls = 60 }")
            return cell(graspd, config, scene)

        def emulators(scene):
            return cell(graspd, EXAMPLES / "sort_emulated.toml", scene)

        def arms(scene):
            faults = '[simulation.arms.left.wire_faults]\narm = ["rtde:cut@25"]\n[simulation.arms.right.wire_faults]\narm = ["protective-stop@30"]'
            return cell(graspd, changed(folder, "sort_emulated.toml", faults), scene)

        cases = [("undisturbed", undisturbed, scenes), ("planner", planner, scenes), ("network", network, scenes),
                 ("adapter", adapter, scenes), ("emulated, undisturbed", emulators, emulated), ("emulated arms", arms, emulated)]
        for name, case, of in [c for c in cases if c[2]]:
            results[name] = runs = []
            for scene in of:
                runs.append(case(scene))
                print(name, runs[-1], file=sys.stderr, flush=True)
            whole = [r for r in runs if "broken" not in r]
            keys = ("delivered", "in_hand", "in_tray", "lost", "misplaced", "unaccounted", "collisions", "arms_lost", "arms_came_back")
            total = {k: sum(r[k] for r in whole) for k in keys}
            print(f"{name}: {len(whole)} of {len(runs)} runs ended, of {OBJECTS * len(whole)} objects", total)
    Path(out).write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
