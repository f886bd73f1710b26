"""Paths, and graspd's own word on its arguments."""

import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
GRASPD = os.environ["GRASPD_BIN"]


def clean_environment() -> dict[str, str]:
    """The environment without settings of graspd."""
    return {k: v for k, v in os.environ.items() if not k.startswith("GRASPD_") and k != "RUST_LOG"}


def accepts(arguments: list[str]) -> None:
    """Fails where graspd does not know these arguments. (Asked for help, it checks those before it.)"""
    done = subprocess.run(
        [GRASPD, *arguments, "--help"], capture_output=True, text=True, env=clean_environment(), timeout=60
    )
    assert done.returncode == 0, f"graspd {' '.join(arguments)}: {done.stderr.strip()}"
