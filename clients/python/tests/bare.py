"""Run by a Python without the extras and with the oldest dependencies: the README's example against a real server."""

from __future__ import annotations

import io
import os
import re
import subprocess
from contextlib import redirect_stdout
from pathlib import Path

import grpc
import numpy as np

import graspd

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Plans what the package's README says."""
    command = [os.environ["GRASPD_BIN"], "serve", "--listen", "127.0.0.1:0"]
    environment = {**os.environ, "NO_COLOR": "1", "RUST_LOG": "info"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
    ) as server:
        try:
            assert server.stdout is not None
            found = next(m for line in server.stdout if (m := re.search(r"local_addr=(127\.0\.0\.1:\d+)", line)))
            os.environ["GRASPD_ADDRESS"] = found[1]
            block = re.search(r"^```python\n(.*?)^```$", (HERE.parent / "README.md").read_text(), re.M | re.S)
            assert block is not None
            names: dict[str, object] = {}
            with redirect_stdout(io.StringIO()) as said:
                exec(block[1], names)
            assert said.getvalue()
            plan = names["plan"]
            assert isinstance(plan, graspd.Plan) and len(plan) > 0
        finally:
            server.terminate()
    print(f"planned with graspd {graspd.__version__}, grpcio {grpc.__version__}, numpy {np.__version__}")


if __name__ == "__main__":
    main()
