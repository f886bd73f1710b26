"""systemd units: `systemd-analyze verify`, and how much of the system they leave open."""

import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from common import DEPLOY, GRASPD, accepts

UNITS = ["graspd.service", "graspd-worker.service"]
# systemd-analyze's exposure, 0 to 10; below 2.5 it says "OK", and it needs the network.
MOST_OPEN = 1.6


def check() -> str:
    if shutil.which("systemd-analyze") is None:
        return "skipped: no systemd-analyze"
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name in UNITS:
            text = (DEPLOY / name).read_text()
            commands = re.findall(r"^ExecStart(?:Pre)?=/usr/bin/graspd (.*)$", text, re.M)
            assert commands, name
            for command in commands:
                accepts(command.split())
            # The binary is where it is today.
            path = Path(folder) / name
            path.write_text(text.replace("/usr/bin/graspd", GRASPD))
            done = subprocess.run(["systemd-analyze", "verify", path], capture_output=True, text=True)
            # Without a running systemd it also complains of the machine's own units.
            complaints = [line for line in done.stderr.splitlines() if name in line]
            assert not complaints, complaints
            done = subprocess.run(
                ["systemd-analyze", "security", "--offline=true", "--no-pager", path], capture_output=True, text=True
            )
            exposure = re.search(r"exposure level for .*: ([0-9.]+)", done.stdout)
            assert exposure, done.stdout + done.stderr
            assert float(exposure[1]) <= MOST_OPEN, f"{name}: {done.stdout}"
            found.append(f"{name} exposes {exposure[1]} of 10")
    return ", ".join(found)
