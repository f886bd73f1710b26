"""Servers that a document starts: until they are ready, while the commands after them run, and how they end."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import time
from pathlib import Path

# A debug build on a busy machine plans a first time before it listens.
PATIENCE_S = 120.0
# What says nothing when it is ready is taken to be so when it has lived for so long.
SETTLED_S = 3.0


class Service:
    """A server that runs behind the commands of a document."""

    def __init__(self, command: str, line: int, folder: Path, environment: dict[str, str], log: Path) -> None:
        """Starts it."""
        self.command, self.line, self.log, self.address = command, line, log, listens(command)
        with log.open("wb") as out:
            # `exec`: the signal at the end is for the program, not for a shell around it.
            words = command if re.match(r"\w+=", command) else f"exec {command}"
            self.process = subprocess.Popen(
                ["bash", "-c", words], cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=out, stderr=out
            )

    def ready(self) -> str | None:
        """Waits until it takes calls; says what went wrong."""
        began = time.monotonic()
        while time.monotonic() - began < PATIENCE_S:
            if self.process.poll() is not None:
                return f"ended with {self.process.returncode} before it was ready"
            if self.address is None:
                if time.monotonic() - began > SETTLED_S:
                    return None
            else:
                with socket.socket() as probe:
                    probe.settimeout(1)
                    if probe.connect_ex(self.address) == 0:
                        return None
            time.sleep(0.05)
        return f"was not ready after {PATIENCE_S:.0f} s"

    def end(self) -> str | None:
        """Asks it to end; says what went wrong."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        elif self.process.returncode != 0:
            return f"had ended with {self.process.returncode}"
        try:
            status = self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return f"did not end within {PATIENCE_S:.0f} s of SIGTERM"
        # Programs that do nothing special about the signal end by it.
        return None if status in (0, -signal.SIGTERM, 128 + signal.SIGTERM) else f"ended with {status} when it was asked to"

    def said(self) -> str:
        """The end of its log."""
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-30:])


def listens(command: str) -> tuple[str, int] | None:
    """Where a server takes calls, for those whose address is known."""
    if re.search(r"\bgraspd serve\b", command):
        named = re.search(r"--listen[ =](\S+):(\d+)", command)
        return (named[1].replace("0.0.0.0", "127.0.0.1"), int(named[2])) if named else ("127.0.0.1", 50051)
    if re.search(r"\bnats-server\b", command):
        return ("127.0.0.1", 4222)
    return None
