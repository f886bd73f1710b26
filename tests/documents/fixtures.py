"""Files that documents tell a reader to bring: a camera's image, a URDF, meshes. Each is made of what the repository has."""

from __future__ import annotations

import math
import shutil
import struct
from collections.abc import Callable
from pathlib import Path


def depth_image(root: Path, to: Path) -> None:
    """A depth image of 16-bit millimetres: the frame that graspd demo plans from."""
    shutil.copy(root / "cli/assets/demo_depth.png", to)


def lens(root: Path, to: Path) -> None:
    """The lens of that image."""
    shutil.copy(root / "cli/assets/demo_frame.json", to)


def grey_map(_root: Path, to: Path) -> None:
    """A box of 60 mm on a table, seen from 600 mm straight above, as a 16-bit PGM for the lens of docs/cpp.md."""
    width, height, focal, cx, cy = 640, 480, 616.3, 310.3, 236.6
    rows = bytearray()
    for v in range(height):
        for u in range(width):
            x, y = (u - cx) / focal * 540, (v - cy) / focal * 540
            rows += struct.pack(">H", 540 if max(abs(x), abs(y)) < 30 else 600)
    to.write_bytes(b"P5\n%d %d\n65535\n" % (width, height) + bytes(rows))


def urdf(root: Path, to: Path) -> None:
    """A gripper's URDF without any description of ours."""
    shutil.copy(root / "hands/library/panda/hand.urdf", to)


def parts(_root: Path, to: Path) -> None:
    """Two closed meshes in millimetres, z up: a block and a hexagonal bar."""
    to.mkdir()
    for name, sides, radius, height in (("block", 4, 28.0, 60.0), ("bar", 6, 20.0, 90.0)):
        ring = [(radius * math.cos(2 * math.pi * i / sides), radius * math.sin(2 * math.pi * i / sides)) for i in range(sides)]
        faces = []
        for i, (a, b) in enumerate(zip(ring, ring[1:] + ring[:1], strict=True)):
            faces += [((*a, 0), (*b, 0), (*b, height)), ((*a, 0), (*b, height), (*a, height))]
            if i:
                faces += [((*ring[0], 0), (*b, 0), (*a, 0)), ((*ring[0], height), (*a, height), (*b, height))]
        # Facets without an area are no facets.
        faces = [f for f in faces if len({*f}) == 3]
        out = bytearray(80) + struct.pack("<I", len(faces))
        for face in faces:
            out += struct.pack("<12f", 0, 0, 0, *(c for point in face for c in point)) + b"\0\0"
        (to / f"{name}.stl").write_bytes(out)


def network(root: Path, to: Path) -> None:
    """A trained network: the one that graspd carries."""
    (weights,) = (root / "models/weights").glob("*.onnx")
    shutil.copy(weights, to)


def cell(root: Path, to: Path) -> None:
    """A cell's file: UR5e and 2F-85, emulated."""
    shutil.copy(root / "cell/examples/ur_robotiq_2f.toml", to)


def mock_cell(root: Path, to: Path) -> None:
    """A cell's file with emulated devices, made one with mock devices as docs/cell.md says: kind = "mock" twice."""
    text = (root / "cell/examples/ur_leap.toml").read_text()
    assert 'kind = "ur"' in text and 'kind = "leap"' in text, "cell/examples/ur_leap.toml names its devices otherwise"
    to.write_text(text.replace('kind = "ur"', 'kind = "mock"').replace('kind = "leap"', 'kind = "mock"'))


def described_urdf(_root: Path, to: Path) -> None:
    """The hand that the description in hands/README.md is of: two fingers that slide, an adaptive joint, a cable."""
    inertial = '<inertial><mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>'

    def box(size: str, at: str) -> str:
        return f'<collision><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></collision>'

    def finger(side: str, sign: int) -> str:
        return (
            f'<link name="{side}_finger">{inertial}{box("0.02 0.008 0.05", f"0 {sign * 0.004} 0.015")}</link>'
            f'<joint name="{side}_joint" type="prismatic"><parent link="base"/><child link="{side}_finger"/>'
            f'<origin xyz="0 {sign * 0.001} 0.06"/><axis xyz="0 {sign} 0"/>'
            '<limit lower="0" upper="0.04" effort="70" velocity="0.1"/></joint>'
        )

    to.write_text(
        f'<?xml version="1.0"?><robot name="my_hand"><link name="base">{inertial}{box("0.06 0.1 0.03", "0 0 0.015")}</link>'
        f'{finger("left", 1)}{finger("right", -1)}'
        f'<link name="tip">{inertial}{box("0.02 0.008 0.01", "0 0.004 0.006")}</link>'
        '<joint name="tip_joint" type="revolute"><parent link="right_finger"/><child link="tip"/>'
        '<origin xyz="0 -0.008 0.041"/><axis xyz="1 0 0"/><limit lower="-0.3" upper="0.3" effort="1" velocity="1"/></joint>'
        f'<link name="cable">{box("0.01 0.01 0.05", "0 0 0")}</link><joint name="cable_joint" type="fixed">'
        '<parent link="base"/><child link="cable"/><origin xyz="0.03 0 -0.02"/></joint></robot>\n'
    )


FIXTURES: dict[str, Callable[[Path, Path], None]] = {
    "depth.png": depth_image,
    "camera.json": lens,
    "depth.pgm": grey_map,
    "my.urdf": urdf,
    "my_gripper.urdf": urdf,
    "my_parts": parts,
    "mine.onnx": network,
    "other.onnx": network,
    "model.onnx": network,
    "cell.toml": cell,
    "mock.toml": mock_cell,
    "described/hand.urdf": described_urdf,
}


def bring(name: str, root: Path, scratch: Path) -> None:
    """Puts a fixture into the scratch folder.

    Raises:
        KeyError: for a name that is no fixture.
    """
    make, to = FIXTURES[name], scratch / name
    if not to.exists():
        to.parent.mkdir(parents=True, exist_ok=True)
        make(root, to)
