"""Pictures and recordings of plans: drawn, looked into, and closed again."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
import rerun

import graspd

mpl.use("Agg")

from matplotlib import pyplot

from graspd import plot, rerun_log


@pytest.fixture(scope="module")
def plan(planner: graspd.Planner, frame: graspd.DepthFrame) -> graspd.Plan:
    return planner.plan(frame, hand="robotiq-2f85", options=graspd.PlanOptions(seed=1))


def test_a_plan_is_drawn(planner: graspd.Planner, frame: graspd.DepthFrame, plan: graspd.Plan, tmp_path: Path) -> None:
    figure = plot.plan(plan, frame, planner.hand_geometry("robotiq-2f85"), count=2)
    assert len(figure.axes) == 2
    for axes, grasp in zip(figure.axes, plan, strict=False):
        assert f"{grasp.score:.2f}" in axes.get_title()
        low, high = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()]).T  # type: ignore[attr-defined]
        # The hand and what it touches are in the picture.
        assert (low < grasp.contact_points).all() and (grasp.contact_points < high).all()
        assert (low < grasp.pose[:3, 3]).all() and (grasp.pose[:3, 3] < high).all()
    file = tmp_path / "plan.png"
    figure.savefig(file, dpi=60)
    pyplot.close(figure)
    pixels = pyplot.imread(file)[..., :3]
    blue = (pixels[..., 2] > pixels[..., 0] + 0.1).mean()
    assert blue > 0.01, "a picture without a hand"


@pytest.mark.parametrize("hand", ["finray-4f", "barrett", "leap"])
def test_every_kind_of_shape_is_drawn(planner: graspd.Planner, hand: str) -> None:
    depth, lens = graspd.examples.box_on_table()
    frame = graspd.DepthFrame(depth, lens)
    found = planner.plan(frame, hand=hand)
    for moment in ("pregrasp", "squeezed"):
        figure = plot.plan(found, frame, planner.hand_geometry(hand), count=1, moment=moment)
        figure.canvas.draw()
        pyplot.close(figure)


def test_scores_and_plans_without_grasps_are_drawn(planner: graspd.Planner, plan: graspd.Plan) -> None:
    figure = plot.scores(plan)
    assert len(figure.axes[0].patches) == 4 * len(plan)
    pyplot.close(figure)
    bare = graspd.DepthFrame(*graspd.examples.box_on_table(box=False))
    nothing = planner.plan(bare, hand="leap")
    for figure in (plot.plan(nothing, bare), plot.scores(nothing)):
        figure.canvas.draw()
        pyplot.close(figure)


def test_a_plan_is_recorded(
    planner: graspd.Planner, frame: graspd.DepthFrame, plan: graspd.Plan, tmp_path: Path
) -> None:
    file = tmp_path / "plan.rrd"
    recording = rerun.RecordingStream("graspd-tests")
    recording.save(file)
    recording.set_time("attempt", sequence=0)
    rerun_log.frame(frame, recording=recording)
    rerun_log.plan(plan, planner.hand_geometry("robotiq-2f85"), count=2, recording=recording)
    recording.set_time("attempt", sequence=1)
    nothing = planner.plan(*graspd.examples.box_on_table(box=False), hand="leap")
    rerun_log.plan(nothing, recording=recording)
    recording.flush()
    recording.disconnect()

    # Rerun's own tool reads what was written.
    def rrd(command: str) -> str:
        environment = {"HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
        tool = Path(sys.executable).with_name("rerun")
        done = subprocess.run(
            [tool, "rrd", command, file], capture_output=True, text=True, check=True, env=environment, timeout=60
        )
        return done.stdout + done.stderr

    assert "verified without error" in rrd("verify")
    said = rrd("print")
    for path, column in [
        ("/camera ", "Pinhole:"),
        ("/camera ", "Transform3D:"),
        ("/camera/depth ", "DepthImage:"),
        ("/grasps/0/contacts ", "Points3D:"),
        ("/grasps/1/contacts/normals ", "Arrows3D:"),
        ("/grasps/0/approach ", "LineStrips3D:"),
        ("/grasps/0/hand/", "Boxes3D:"),
        ("/grasps/seconds/total ", "Scalars:"),
        ("/grasps/log ", "TextLog:"),
        ("/grasps ", "Clear:"),
    ]:
        assert any(f"- {path}" in line and column in line for line in said.splitlines()), (path, column)
    assert "/grasps/2" not in said
