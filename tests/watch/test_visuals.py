"""Robots: shapes of their files at the poses that the format's formulas give; damaged meshes."""

from __future__ import annotations

import struct
import warnings
from contextlib import suppress

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cotree
from cotree.watch import shapes
from cotree.watch.shapes import MeshError, coarser, find_mesh, read_mesh

ROBOT = """<robot name="arm">
<link name="base"/>
<link name="upper">
 <inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial>
 <visual><origin xyz="0.1 0.2 0.3" rpy="0.3 -0.4 0.5"/><geometry>{upper}</geometry></visual>
</link>
<link name="fore">
 <inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1"/></inertial>
 <visual><origin xyz="0 0 0.25" rpy="1 0 0"/><geometry>{fore}</geometry></visual>
</link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
 <origin xyz="0 0 0.5" rpy="0.1 0.2 0.3"/><axis xyz="0 1 0"/></joint>
<joint name="elbow" type="prismatic"><parent link="upper"/><child link="fore"/>
 <origin xyz="0 0 0.4" rpy="-0.2 0.1 1.0"/><axis xyz="0 0 1"/></joint>
</robot>"""
BOX = '<box size="0.2 0.3 0.4"/>'
CYLINDER = '<cylinder radius="0.05" length="0.5"/>'
TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def mesh_tag(name, scale="1 1 1"):
    return f'<mesh filename="{name}" scale="{scale}"/>'


def animated(folder, upper=BOX, fore=CYLINDER, **settings):
    (folder / "arm.urdf").write_text(ROBOT.format(upper=upper, fore=fore))
    model = cotree.read_urdf(folder / "arm.urdf").compile(tunable=[], optimize="-O0")
    result = model.simulate((0, 0.3), np.linspace(0, 0.3, 8))
    return result, result.animate(**settings).drawing


def fixed_angles(rpy, xyz):
    """Return the pose of an <origin>: turns about the fixed x, y and z axis, in this order."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    pose[:3, 3] = xyz
    return pose


def binary_stl(points, faces):
    rows = b"".join(struct.pack("<12fH", 0, 0, 1, *points[face].ravel(), 0) for face in faces)
    return bytes(80) + struct.pack("<I", len(faces)) + rows


def text_stl(points, faces):
    lines = ["solid thing"]
    for face in faces:
        lines += ["facet normal 0 0 1", "outer loop"]
        lines += [f"vertex {x} {y} {z}" for x, y, z in points[face]]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid thing"]).encode()


def obj(points, faces):
    lines = ["# a comment", *(f"v {x} {y} {z}" for x, y, z in points)]
    lines += ["f " + " ".join(f"{i + 1}/1/1" for i in face) for face in faces[:-1]]
    # Numbers that count from the last corner are the same ones.
    lines.append("f " + " ".join(str(i - len(points)) for i in faces[-1]))
    return "\n".join(lines).encode()


WRITERS = {"a.stl": binary_stl, "b.STL": text_stl, "c.obj": obj}


def corners_of(mesh):
    return sorted(map(tuple, np.round(mesh.points[mesh.faces].reshape(-1, 9), 6).tolist()))


def test_visuals_are_where_the_format_puts_them(tmp_path):
    result, drawing = animated(tmp_path)
    frame = len(drawing.frames.times) - 1
    theta, s = result["shoulder.theta"][-1], result["elbow.s"][-1]
    assert abs(theta) > 1e-2
    upper = fixed_angles([0.1, 0.2, 0.3], [0, 0, 0.5]) @ fixed_angles([0, theta, 0], [0, 0, 0])
    fore = upper @ fixed_angles([-0.2, 0.1, 1.0], [0, 0, 0.4]) @ fixed_angles([0, 0, 0], [0, 0, s])
    expected = {
        "upper": (
            upper @ fixed_angles([0.3, -0.4, 0.5], [0.1, 0.2, 0.3]),
            shapes.box(0.2, 0.3, 0.4),
        ),
        "fore": (fore @ fixed_angles([1, 0, 0], [0, 0, 0.25]), shapes.cylinder(0.05, 0.5)),
    }
    for name, (pose, mesh) in expected.items():
        (solid,) = [row for row in drawing.solids if row.name == name]
        axes = drawing.poses.axes[solid.track, frame]
        found = solid.mesh.points @ axes.T + drawing.poses.positions[solid.track, frame]
        # Rounding of a few operations.
        np.testing.assert_allclose(found, mesh.points @ pose[:3, :3].T + pose[:3, 3], atol=1e-12)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("file", WRITERS)
def test_meshes_are_read_placed_and_scaled(tmp_path, file):
    folder = tmp_path / "pack" / "meshes"
    folder.mkdir(parents=True)
    (folder / file).write_bytes(WRITERS[file](TETRAHEDRON, FACES))
    (tmp_path / "pack" / "urdf").mkdir()
    tag = mesh_tag(f"package://pack/meshes/{file}", "2 3 -4")
    _, drawing = animated(tmp_path / "pack" / "urdf", upper=tag)
    (solid,) = [row for row in drawing.solids if row.name == "upper"]
    # Scaled, mirrored in z so that faces turn, then placed by the <origin>.
    pose = fixed_angles([0.1, 0.2, 0.3], [0, 0, 0.5])  # the joint's; its angle is zero at first
    pose = pose @ fixed_angles([0.3, -0.4, 0.5], [0.1, 0.2, 0.3])
    points = (TETRAHEDRON * [2, 3, -4]) @ pose[:3, :3].T + pose[:3, 3]
    a, b, c = (solid.mesh.points[solid.mesh.faces[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(4.0)  # 24 times a sixth, and outside is outside
    axes, at = drawing.poses.axes[solid.track, 0], drawing.poses.positions[solid.track, 0]
    found = np.unique(np.round(solid.mesh.points @ axes.T + at, 9), axis=0)
    np.testing.assert_allclose(found, np.unique(np.round(points, 9), axis=0), atol=1e-8)


@pytest.mark.slow
def test_missing_meshes_are_told_once_and_drawn_as_bars(tmp_path):
    tag = mesh_tag("package://nowhere/a.stl")
    with pytest.warns(RuntimeWarning, match=r"1 of 1 meshes are not drawn.*nowhere/a\.stl") as told:
        _, drawing = animated(tmp_path, tag, tag)
    assert len(told) == 1
    assert {"shoulder", "elbow"} <= {solid.name for solid in drawing.solids}
    (tmp_path / "empty.stl").write_bytes(b"")
    with pytest.warns(RuntimeWarning, match="no triangles"):
        animated(tmp_path, mesh_tag("empty.stl"))


def test_meshes_are_found_along_the_package_path(tmp_path, monkeypatch):
    robot = tmp_path / "elsewhere" / "arm.urdf"
    file = tmp_path / "ros" / "pack" / "m" / "a b.stl"
    file.parent.mkdir(parents=True)
    robot.parent.mkdir()
    file.write_bytes(binary_stl(TETRAHEDRON, FACES))
    with pytest.raises(MeshError, match="not found"):
        find_mesh("package://pack/m/a b.stl", robot)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'no'}:{tmp_path / 'ros'}")
    assert find_mesh("package://pack/m/a b.stl", robot) == file
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(file.parents[1]))  # the package itself
    assert find_mesh("package://pack/m/a b.stl", robot) == file
    url = f"file://{file}".replace(" ", "%20")
    assert find_mesh(url, robot, trust_paths=True) == file
    assert find_mesh(url, file.parents[1] / "arm.urdf") == file


@pytest.mark.parametrize(
    "name",
    ["../x.stl", "sub/../../x.stl", "{folder}/x.stl", "file://{folder}/x.stl", "link.stl"]
    + [f"package://{package}/../x.stl" for package in ("robot", "robot/sub/..")],
)
def test_meshes_outside_the_robots_folder_are_read_only_where_paths_are_trusted(tmp_path, name):
    (tmp_path / "x.stl").write_bytes(binary_stl(TETRAHEDRON, FACES))
    robot = tmp_path / "robot" / "arm.urdf"
    (robot.parent / "sub").mkdir(parents=True)
    (robot.parent / "link.stl").symlink_to(tmp_path / "x.stl")
    name = name.format(folder=tmp_path)
    with pytest.raises(MeshError, match="outside the robot's folder: give trust_paths=True"):
        find_mesh(name, robot)
    assert find_mesh(name, robot, trust_paths=True).samefile(tmp_path / "x.stl")


def test_trust_in_paths_is_passed_on_by_animations(tmp_path):
    (tmp_path / "x.stl").write_bytes(binary_stl(TETRAHEDRON, FACES))
    (tmp_path / "robot").mkdir()
    tag = mesh_tag("../x.stl")
    with pytest.warns(RuntimeWarning, match="outside the robot's folder"):
        animated(tmp_path / "robot", tag)
    _, drawing = animated(tmp_path / "robot", tag, trust_paths=True)
    assert drawing.solids  # without a warning


@pytest.mark.parametrize(
    "name",
    ["http://x/a.stl", "", "package://", "a\0b.stl", "x" * 5000, "package://x/" + "../" * 99],
)
def test_names_that_are_no_files_are_told(tmp_path, name):
    with pytest.raises(MeshError):
        find_mesh(name, tmp_path / "arm.urdf")


@pytest.mark.parametrize("file", WRITERS)
def test_damaged_meshes_are_told_or_read(tmp_path, file):
    whole = WRITERS[file](TETRAHEDRON, FACES)
    path = tmp_path / file
    rng = np.random.default_rng(1)
    damaged = [whole[:n] for n in range(0, len(whole), 7)]
    for _ in range(100):
        other = bytearray(whole)
        for place in rng.integers(0, len(whole), 4):
            other[place] = rng.integers(0, 256)
        damaged.append(bytes(other))
    for data in damaged:
        path.write_bytes(data)
        with suppress(MeshError):
            mesh = read_mesh(path)
            assert np.isfinite(mesh.points).all()
            assert mesh.faces.max() < len(mesh.points)


def test_formats_that_need_more_name_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "trimesh", None)
    (tmp_path / "a.dae").write_text("<COLLADA/>")
    with pytest.raises(MeshError, match=r"cotree\[meshes\]"):
        read_mesh(tmp_path / "a.dae")


DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset/>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array>
<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 2 1 0 1 3 1 2 3 0 3 2</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><translate>0 0 5</translate>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


def test_collada_is_read_where_its_reader_is_installed(tmp_path):
    pytest.importorskip("trimesh")
    pytest.importorskip("collada")
    (tmp_path / "a.dae").write_text(DAE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the readers, of themselves
        mesh = read_mesh(tmp_path / "a.dae")
        (tmp_path / "b.dae").write_text(DAE[:700])
        with pytest.raises(MeshError, match=r"b\.dae"):
            read_mesh(tmp_path / "b.dae")
    shifted = corners_of(shapes.Mesh(TETRAHEDRON + np.array([0, 0, 5]), FACES))
    assert corners_of(mesh) == shifted


def test_coarser_meshes_keep_their_size():
    fine = shapes.sphere(1.0)
    mesh = shapes.Mesh(fine.points, fine.faces)
    few = coarser(mesh, 200)
    assert 50 < len(few.faces) <= 200
    np.testing.assert_allclose(np.ptp(few.points, axis=0), 2.0, rtol=0.15)
    assert coarser(mesh, 10_000) is mesh
