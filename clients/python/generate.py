"""Generates the stubs in src/graspd/v1 from the protocol's files, or checks that they are what those give.

Usage: generate.py [--check], in an environment with the packages of requirements-check.txt.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
PROTOCOL = HERE.parent.parent / "proto"
STUBS = HERE / "src" / "graspd" / "v1"

INIT = '"""The messages and services of the package graspd.v1, generated from the protocol\'s files."""\n'


def generated() -> dict[str, bytes]:
    """Contents of every stub by its file name."""
    files = sorted((PROTOCOL / "graspd" / "v1").glob("*.proto"))
    plugins = Path(sys.executable).parent
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "grpc_tools.protoc", f"-I{PROTOCOL}"]
        for kind in ("mypy", "mypy_grpc"):
            command.append(f"--plugin=protoc-gen-{kind}={plugins / f'protoc-gen-{kind}'}")
        command += [f"--{kind}_out={folder}" for kind in ("python", "grpc_python", "mypy", "mypy_grpc")]
        subprocess.run([*command, *map(str, files)], check=True, capture_output=True)
        found = {path.name: path.read_bytes() for path in (Path(folder) / "graspd" / "v1").iterdir()}
    services = {file.stem for file in files if file.stem.endswith("_service")}
    kept = {
        name: contents
        for name, contents in found.items()
        # Files without a service have empty service stubs.
        if "_pb2_grpc." not in name or name.split("_pb2_grpc.")[0] in services
    }
    return {"__init__.py": INIT.encode(), **kept}


def differences() -> list[str]:
    """What is not as generated, a line for each file."""
    wanted = generated()
    present = {path.name: path.read_bytes() for path in STUBS.iterdir() if path.is_file()}
    told = []
    for name in sorted(wanted.keys() | present.keys()):
        if name not in present:
            told.append(f"{name}: missing")
        elif name not in wanted:
            told.append(f"{name}: nothing in the protocol gives it")
        elif wanted[name] != present[name]:
            told.append(f"{name}: differs")
    return told


def main(arguments: list[str]) -> int:
    """Writes or checks."""
    if arguments == ["--check"]:
        told = differences()
        print("\n".join(told) if told else "stubs are what the protocol gives")
        return 1 if told else 0
    if arguments:
        print(__doc__)
        return 2
    STUBS.mkdir(parents=True, exist_ok=True)
    wanted = generated()
    for path in STUBS.iterdir():
        if path.is_file() and path.name not in wanted:
            path.unlink()
    for name, contents in wanted.items():
        (STUBS / name).write_bytes(contents)
    print(f"{len(wanted)} files in {STUBS.relative_to(HERE)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
