"""A server's recording, opened by Rerun's own reader."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import graspd
from tests.conftest import Server


def rerun(*arguments: str) -> str:
    """Rerun's command, as its package installs it."""
    command = [str(Path(sys.executable).with_name("rerun")), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def recording(frame: graspd.DepthFrame, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One plan of one hand."""
    folder = tmp_path_factory.mktemp("recording")
    server = Server("--record", str(folder))
    try:
        with graspd.connect(server.address, timeout=120.0) as planner:
            seen = graspd.DepthFrame(frame.depth, frame.intrinsics, camera_pose=np.eye(4))
            assert planner.plan(seen, hand="robotiq-3f", options=graspd.PlanOptions(seed=1))
    finally:
        server.stop()
    (file,) = folder.glob("*.mcap")
    return file


def test_nothing_is_wrong_with_it(recording: Path) -> None:
    said = rerun("mcap", "check", "--full", str(recording))
    rows = [line.split() for line in said.splitlines() if "/" in line and "Chunks" not in line]
    topics = {row[3]: row[0] for row in rows if len(row) > 4 and row[0] in ("ok", "warning", "error")}
    assert topics.get("/grasps/points") == "ok", said
    assert set(topics.values()) == {"ok"}, said


def test_it_shows_camera_points_and_the_hand(recording: Path, tmp_path: Path) -> None:
    shown = tmp_path / "shown.rrd"
    rerun("mcap", "convert", str(recording), "--output", str(shown))
    assert "verified without error" in rerun("rrd", "verify", str(shown))
    stats = rerun("rrd", "stats", str(shown))
    # What Rerun draws: the cameras' points and the grasps', the image, its lens, and where the camera stood.
    for component in ("Points3D:positions: 2", "Points3D:colors", "Image:buffer: 1", "Pinhole:resolution: 1"):
        assert component in stats, stats
    for topic in ("/camera/0/points", "/camera/0/depth", "/grasps/points", "/grasps/poses"):
        assert f"{topic}: " in stats, stats
