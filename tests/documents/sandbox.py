"""Where documents are run: a network and processes of their own, a scratch folder, and programs that stand for the reader's."""

from __future__ import annotations

import fcntl
import os
import shutil
import socket
import struct
import subprocess
import sys
import textwrap
from pathlib import Path

INSIDE = "GRASPD_DOCUMENTS_INSIDE"
# Documents name these; another program there would be talked to instead of ours.
PORTS = (50051, 4222, 29999, 30001, 30002, 30004)
# Linux: SIOCGIFFLAGS, SIOCSIFFLAGS, IFF_UP.
GET_FLAGS, SET_FLAGS, UP = 0x8913, 0x8914, 1


def enter() -> None:
    """Runs this program again in namespaces of its own, where the system allows it: free ports, and nothing left running."""
    if os.environ.get(INSIDE):
        raise_loopback()
        return
    isolate = ["unshare", "--net", "--pid", "--fork", "--kill-child", "--mount-proc"]
    for ways in (isolate, [*isolate, "--user", "--map-root-user"]):
        try:
            if subprocess.run([*ways, "true"], capture_output=True, check=False).returncode == 0:
                os.environ[INSIDE] = "namespace"
                os.execvp(ways[0], [*ways, sys.executable, *sys.argv])
        except FileNotFoundError:
            break
    print("no namespaces here: documents share ports and processes with everything else on this machine")
    for port in PORTS:
        with socket.socket() as probe:
            probe.settimeout(1)
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                sys.exit(f"found a program at 127.0.0.1:{port}, expected nothing there: documents use this port")


def raise_loopback() -> None:
    """A new network has a loopback that is down."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        request = struct.pack("16sh14x", b"lo", 0)
        _, flags = struct.unpack("16sh14x", fcntl.ioctl(s, GET_FLAGS, request))
        if not flags & UP:
            fcntl.ioctl(s, SET_FLAGS, struct.pack("16sh14x", b"lo", flags | UP))


# `cargo` of the documents: the same programs in the build that the tests have made.
CARGO = """\
    #!/usr/bin/env python3
    # Stands for cargo while documents are run: "cargo run" is the build that there is, benchmarks run each case once.
    import os, subprocess, sys
    root, target, graspd, cargo = {root!r}, {target!r}, {graspd!r}, {cargo!r}
    words = sys.argv[1:]
    own, rest = (words[: words.index("--")], words[words.index("--") + 1 :]) if "--" in words else (words, [])
    def value(option):
        return own[own.index(option) + 1] if option in own else None
    def build(*what):
        # Of the whole workspace: what the tests have built is found as it is.
        done = subprocess.run([cargo, *what, "--quiet", "--offline", "--workspace"], cwd=root)
        if done.returncode:
            sys.exit(done.returncode)
    if own[:1] == ["run"] and value("--example"):
        build("build", "--example", value("--example"))
        program = os.path.join(target, "debug/examples", value("--example"))
        os.execv(program, [program, *rest])
    if own[:1] == ["run"] and "-p" not in own:
        os.execv(graspd, [graspd, *rest])
    if own == ["install", "--path", "cli"]:
        # The same crate, of the build that there is, into the reader's home.
        home = os.path.join(os.environ["HOME"], ".cargo")
        done = subprocess.run([cargo, "install", "--debug", "--quiet", "--offline", "--locked", "--path", "cli", "--root", home], cwd=root)
        sys.exit(done.returncode or subprocess.run([os.path.join(home, "bin/graspd"), "--version"]).returncode)
    if own[:1] == ["bench"] and value("--bench"):
        build("test", "--bench", value("--bench"))
        sys.exit(0)
    sys.exit(f"found cargo {{' '.join(words)}}, expected a cargo command that stands for a build that there is; give the block a "
             "directive")
"""

# `pip` of the documents: into an environment over that of the Python client's tests, which has every dependency; no network.
PIP = """\
    #!/bin/sh
    # Stands for pip while documents are run: what is installed comes from the repository, dependencies are there already.
    [ "$1" = install ] && shift && set -- install --no-build-isolation --no-index --quiet "$@"
    exec {python!r} -m pip --disable-pip-version-check "$@"
"""


class Sandbox:
    """Programs and environment that all documents share."""

    def __init__(self, root: Path, graspd: Path, target: Path, work: Path) -> None:
        """Makes the programs in `work`, which is emptied."""
        self.root, self.work, self.bin = root, work, work / "bin"
        shutil.rmtree(work, ignore_errors=True)
        self.bin.mkdir(parents=True)
        self._program("cargo", CARGO, root=str(root), target=str(target), graspd=str(graspd), cargo=shutil.which("cargo"))
        (self.bin / "graspd").symlink_to(graspd)
        broker = target / "tmp/nats-server/bin/nats-server"
        named = os.environ.get("GRASPD_NATS_SERVER")
        if named or (not shutil.which("nats-server") and broker.exists()):
            (self.bin / "nats-server").symlink_to(named or broker)
        self.python = self._python(target / "python-client/venv")
        keep = {k: v for k, v in os.environ.items() if not k.startswith(("GRASPD_", "RUST_LOG", "PYTHON", "VIRTUAL_ENV"))}
        home = Path.home()
        self.environment = keep | {
            "PATH": f"{self.bin}:{os.environ['PATH']}",
            "NO_COLOR": "1",
            "MPLBACKEND": "Agg",
            # Tools that are the reader's, not the document's.
            "CARGO_HOME": os.environ.get("CARGO_HOME", str(home / ".cargo")),
            "RUSTUP_HOME": os.environ.get("RUSTUP_HOME", str(home / ".rustup")),
            "CARGO_TARGET_DIR": str(target),
        }

    def _program(self, name: str, text: str, **values: str | None) -> None:
        path = self.bin / name
        path.write_text(textwrap.dedent(text).format(**values))
        path.chmod(0o755)

    def _python(self, client: Path) -> str | None:
        """An environment over the one of the client's tests; `None` where that was not made."""
        if not (client / "ready").exists():
            return None
        own = self.work / "venv"
        # The interpreter of the client's environment, so that its packages fit.
        subprocess.run([client / "bin/python", "-m", "venv", own], check=True)
        below, above = (
            subprocess.run(
                [f / "bin/python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
                check=True,
                capture_output=True,
                text=True,
            ).stdout.strip()
            for f in (client, own)
        )
        # And what training/README.md tells to install, which needs torch for training alone.
        Path(above, "graspd.pth").write_text(f"{below}\n{self.root / 'training/train'}\n")
        python = str(own / "bin/python")
        self._program("pip", PIP, python=python)
        for name in ("python", "python3"):
            # Not a link: by its own path an interpreter knows its environment.
            self._program(name, '#!/bin/sh\nexec {python!r} "$@"\n', python=python)
        return python

    def scratch(self, name: str) -> Path:
        """A new folder that looks like the repository's root: what documents name is there, what they write is not kept."""
        folder = self.work / "scratch" / name.replace("/", "_").removesuffix(".md")
        folder.mkdir(parents=True)
        tracked = subprocess.run(["git", "ls-files", "-z"], cwd=self.root, check=True, capture_output=True, text=True).stdout
        for top in {path.split("/")[0] for path in tracked.split("\0") if path}:
            (folder / top).symlink_to(self.root / top)
        # Shells have these.
        for usual in ("home", "target"):
            (folder / usual).mkdir()
        return folder

    def variables(self, scratch: Path) -> dict[str, str]:
        """The environment of a document's commands."""
        home = str(scratch / "home")
        return self.environment | {"HOME": home, "TMPDIR": self._temporary(scratch)}

    @staticmethod
    def _temporary(scratch: Path) -> str:
        folder = scratch / "home/tmp"
        folder.mkdir(exist_ok=True)
        return str(folder)
