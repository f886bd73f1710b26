"""Hands against a real server: listed, described, created, deleted, and their geometry where a grasp puts it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

import graspd
from graspd.convert import meshes
from graspd.hands import MeshForm, geometry_from_wire, read_files, upload
from graspd.poses import Array
from graspd.v1 import hand_service_pb2
from tests.conftest import REPOSITORY, Server

LIBRARY = REPOSITORY / "hands" / "library"
IDS = sorted(path.name for path in LIBRARY.iterdir() if path.is_dir())

TETRAHEDRON = b"""v 0 0 0
v 0.02 0 0
v 0 0.02 0
v 0 0 0.02
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


def distances(mesh: trimesh.Trimesh, points: Array) -> Array:
    """Distance of each point from the surface of a mesh."""
    triangles = np.asarray(mesh.triangles)
    nearest = [trimesh.triangles.closest_point(triangles, np.tile(p, (len(triangles), 1))) for p in points]
    return np.array([np.linalg.norm(n - p, axis=1).min() for n, p in zip(nearest, points, strict=True)])


def test_hands_are_listed_and_described(planner: graspd.Planner) -> None:
    hands = planner.hands()
    assert [hand.id for hand in hands] == IDS
    leap = planner.hand("leap")
    assert leap.name == "hands/leap" and leap.origin == "library" and leap.create_time is None
    assert len(leap.joints) == len(leap.actuators) == 16 and len(leap.fingers) == 4 and leap.contact_candidates == 30
    assert {j.kind for j in leap.joints} == {"revolute"}
    assert np.isclose(np.linalg.norm(leap.approach), 1) and leap.tool_point.shape == (3,)
    assert planner.hand(leap).revision == planner.hand("hands/leap").revision == leap.revision
    gripper = planner.hand("robotiq-2f85")
    assert gripper.opening is not None and 0 <= gripper.opening[0] < gripper.opening[1] < 0.2
    with pytest.raises(graspd.NotFoundError):
        planner.hand("nobody")
    with pytest.raises(graspd.InvalidArgumentError) as caught:
        planner.hand("No Body")
    assert caught.value.fields == ("name",)


def test_hands_are_listed_in_pages(planner: graspd.Planner) -> None:
    page = planner._list_hands(hand_service_pb2.ListHandsRequest(page_size=4), None)
    assert len(page.hands) == 4 and page.next_page_token
    found = [h.name for h in page.hands]
    while page.next_page_token:
        request = hand_service_pb2.ListHandsRequest(page_size=4, page_token=page.next_page_token)
        page = planner._list_hands(request, None)
        found += [h.name for h in page.hands]
    assert found == [f"hands/{hand}" for hand in IDS]


@pytest.mark.parametrize("id", IDS)
def test_the_hand_touches_where_the_plan_says(planner: graspd.Planner, frame: graspd.DepthFrame, id: str) -> None:
    geometry = planner.hand_geometry(id)
    plan = planner.plan(frame, hand=id, options=graspd.PlanOptions(seed=1))
    assert geometry.hand == id and geometry.revision == plan.stats.hand_revision
    assert len(plan) > 0
    for grasp in plan[:3]:
        mesh = meshes.hand_mesh(geometry, grasp)
        # Contacts are known to about a voxel, and pads have some thickness before a shape's surface.
        assert distances(mesh, grasp.contact_points).max() < 0.009
        links = meshes.link_meshes(geometry, grasp, shapes="collision")
        for contact in grasp.contacts:
            assert distances(links[contact.link], contact.point[None]).max() < 0.009, contact
        # Open and away, the hand does not touch; nor does it reach into the table.
        away = meshes.hand_mesh(geometry, grasp, "pregrasp")
        assert distances(away, grasp.contact_points).min() > 0.005
        assert mesh.bounds[0, 2] > -0.006 and away.bounds[0, 2] > -0.006
        frames = geometry.link_poses(grasp.joints.contact)
        assert np.allclose(frames[grasp.wrist_link], np.eye(4))


def test_a_hand_comes_is_used_and_goes(planner: graspd.Planner, frame: graspd.DepthFrame) -> None:
    folder = LIBRARY / "antipodal"
    checked = planner.create_hand("my-gripper", folder, validate_only=True)
    assert checked.hand.id == "my-gripper" and checked.proposed_toml is None
    with pytest.raises(graspd.NotFoundError):
        planner.hand("my-gripper")
    created = planner.create_hand("my-gripper", str(folder))
    try:
        assert created.hand.origin == "created" and created.hand.create_time is not None
        assert created.hand.revision == planner.hand("antipodal").revision
        assert len(planner.plan(frame, hand=created.hand)) > 0
        with pytest.raises(graspd.AlreadyExistsError, match="my-gripper"):
            planner.create_hand("my-gripper", folder)
    finally:
        planner.delete_hand("my-gripper")
    with pytest.raises(graspd.NotFoundError):
        planner.plan(frame, hand="my-gripper")
    with pytest.raises(graspd.FailedPreconditionError, match="cannot be deleted"):
        planner.delete_hand("leap")


def test_a_description_is_proposed(planner: graspd.Planner) -> None:
    files = {"hand.urdf": (LIBRARY / "panda" / "hand.urdf").read_bytes()}
    created = planner.create_hand("proposed", files, validate_only=True)
    assert created.proposed_toml is not None and "[[pads]]" in created.proposed_toml


def test_faulty_files_are_named(planner: graspd.Planner) -> None:
    files = read_files(LIBRARY / "antipodal")
    files["hand.toml"] += b"\n[nonsense]\nx = 1\n"
    with pytest.raises(graspd.InvalidArgumentError) as caught:
        planner.create_hand("faulty", files)
    assert caught.value.reason == "INVALID_HAND"
    assert caught.value.violations[0].field == 'files["hand.toml"]'
    assert "nonsense" in caught.value.violations[0].description
    with pytest.raises(graspd.InvalidArgumentError) as caught:
        planner.create_hand("faulty", {"../hand.urdf": b""})
    assert caught.value.fields == ("chunk.path",)
    with pytest.raises(FileNotFoundError, match="found no folder"):
        planner.create_hand("faulty", "/nowhere/at/all")


def test_meshes_come_back_as_they_were_sent(planner: graspd.Planner) -> None:
    files = read_files(LIBRARY / "antipodal")
    urdf = files["hand.urdf"].decode()
    link = planner.hand("antipodal").wrist_link
    drawn = (
        f'<link name="ornament"><visual><geometry><mesh filename="meshes/drop.obj"/></geometry></visual></link>'
        f'<joint name="glue" type="fixed"><parent link="{link}"/><child link="ornament"/>'
        f'<origin xyz="0 0 -0.1"/></joint></robot>'
    )
    files["hand.urdf"] = urdf.replace("</robot>", drawn).encode()
    files["meshes/drop.obj"] = TETRAHEDRON
    planner.create_hand("drop", files)
    try:
        geometry = planner.hand_geometry("drop")
    finally:
        planner.delete_hand("drop")
    (shape,) = [s for s in geometry.visual_shapes if s.link == "ornament"]
    assert isinstance(shape.form, MeshForm)
    assert np.allclose(shape.form.vertices, 0.02 * np.eye(4, 3, -1), atol=1e-7)
    assert shape.form.triangles.tolist() == [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    mesh = meshes.shape_mesh(shape)
    assert mesh.is_watertight and np.isclose(mesh.volume, 0.02**3 / 6, rtol=1e-5)
    assert np.allclose(shape.body_from_shape, graspd.pose([0, 0, -0.1]))


def test_files_travel_in_pieces(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "hand.urdf").write_bytes(b"u" * ((1 << 20) + 5))
    (tmp_path / "meshes" / "empty.stl").write_bytes(b"")
    (tmp_path / ".hidden").write_bytes(b"x")
    files = read_files(tmp_path)
    assert sorted(files) == ["hand.urdf", "meshes/empty.stl"]
    first, *rest = upload("claw", files, True)
    assert first.header.hand_id == "claw" and first.header.validate_only
    assert [(m.chunk.path, len(m.chunk.data)) for m in rest] == [
        ("hand.urdf", 1 << 20),
        ("hand.urdf", 5),
        ("meshes/empty.stl", 0),
    ]


def test_a_folder_of_hands_is_offered(tmp_path: Path) -> None:
    for name, contents in read_files(LIBRARY / "panda").items():
        (tmp_path / "own").mkdir(exist_ok=True)
        (tmp_path / "own" / name).write_bytes(contents)
    server = Server("--hands-dir", str(tmp_path))
    try:
        with graspd.connect(server.address) as planner:
            assert planner.hand("own").origin == "folder"
            with pytest.raises(graspd.FailedPreconditionError):
                planner.delete_hand("own")
    finally:
        server.stop()


def test_a_broken_geometry_is_not_believed() -> None:
    wire = hand_service_pb2
    root, revolute = wire.HandBody(), wire.JOINT_TYPE_REVOLUTE
    for broken, said in [
        (
            wire.GetHandGeometryResponse(bodies=[root, wire.HandBody(parent=1, joint_type=revolute)]),
            "does not come before",
        ),
        (wire.GetHandGeometryResponse(bodies=[root, wire.HandBody(parent=0)]), "does not know"),
        (wire.GetHandGeometryResponse(bodies=[root], links=[wire.HandLink(body=1)]), "does not exist"),
        (wire.GetHandGeometryResponse(bodies=[root], visual_shapes=[wire.HandShape(link="a")]), "does not know"),
        (
            wire.GetHandGeometryResponse(
                bodies=[root], visual_shapes=[wire.HandShape(mesh=wire.MeshShape(triangles=[0, 1, 2]))]
            ),
            "vertices that it has not",
        ),
    ]:
        with pytest.raises(graspd.ProtocolError, match=said):
            geometry_from_wire("x", broken)
