"""Translation of URDF files, element by element, and refusal of wrong ones."""

from __future__ import annotations

import re

import numpy as np
import pytest
from urdf_texts import ROBOTS, WHOLE

import cotree
from cotree.pipeline import formulate
from cotree.readers.urdf.scene import rotation_rows


@pytest.fixture
def read(tmp_path):
    def read_text(text=WHOLE, **options):
        path = tmp_path / "robot.urdf"
        path.write_text(text, encoding="utf-8")
        return cotree.read_urdf(path, **options)

    return read_text


def number(value):
    return [number(item) for item in value] if isinstance(value, tuple) else value.number


def test_joints_are_edges_between_links(read):
    scene = read()
    found = {e.name: (e.component.name, e.nodes) for e in scene.edges.values()}
    assert found["base"] == ("weld", ("ground", "base_link"))
    assert found["shoulder_joint_origin"] == ("arm", ("base_link", "shoulder_joint_frame"))
    assert found["shoulder_joint"] == ("revolute", ("shoulder_joint_frame", "upper_arm"))
    assert found["slide"] == ("prismatic", ("slide_frame", "slider"))
    assert found["follow"] == ("revolute", ("follow_frame", "follower"))
    assert found["flange"] == ("arm", ("slider", "tool"))
    assert found["follow_mimic"] == ("gear", ("follower", "upper_arm"))
    assert tuple(scene.inputs) == ("shoulder_joint_torque", "slide_force")


def test_frames_and_axes(read):
    edges = read().edges
    assert number(edges["shoulder_joint_origin"].fields["vector"]) == [0.0, 0.0, 0.3]
    # A quarter turn about x, without the 6e-17 of its cosine.
    turned = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
    assert number(edges["shoulder_joint_origin"].fields["rotation"]) == turned
    assert "rotation" not in edges["slide_origin"].fields
    assert number(edges["slide"].fields["axis"]) == [1.0, 0.0, 0.0]


def test_inertia_is_made_of_parameters(read):
    scene = read()
    values = {name: row.value for name, row in scene.parameters.items()}
    assert values["base_link_mass"] == 4.0
    assert values["base_link_cz"] == 0.1
    assert values["base_link_iyz"] == -0.002
    assert scene.parameters["base_link_ixx"].unit == "kg m^2"
    assert scene.edges["base_link_body"].nodes == ("ground", "base_link_com")
    tensor = scene.edges["base_link_body"].fields["inertia"]
    assert [row[1].text for row in tensor] == ["base_link_ixy", "base_link_iyy", "base_link_iyz"]
    centre = scene.edges["base_link_centre"]
    assert number(centre.fields["rotation"])[2][0] == pytest.approx(-np.sin(0.2), rel=1e-15)
    assert "tool_mass" not in values


def test_damping_and_smooth_friction(read):
    scene = read(mimic=False)
    model = scene.compile()
    at = {name: i for i, name in enumerate(model.states)}
    torques = []
    for rate in (-1.0, 1e-3, 0.0, 2.0):
        y = model.initial_state
        y[at["shoulder_joint.theta_dot"]] = rate
        # What the joint loses is what an input has to give to leave the acceleration as it is
        # without losses.
        lossless = model.kernels.parameter_array(
            {"shoulder_joint_damping": 0.0, "shoulder_joint_friction": 0.0}
        )
        loss = 0.7 * rate + 0.2 * rate / np.hypot(rate, 0.01)
        u = np.zeros(len(model.inputs))
        u[model.inputs.index("shoulder_joint_torque")] = loss
        torques.append(loss)
        np.testing.assert_allclose(
            model.rhs(0.0, y, u=u), model.rhs(0.0, y, lossless), rtol=1e-12, atol=1e-12
        )
    assert torques[0] < -0.89
    assert torques[3] > 1.59


@pytest.mark.slow
def test_mimic_starts_at_its_offset_and_follows(read):
    result = read().compile().simulate((0.0, 0.5), rtol=1e-9)
    np.testing.assert_allclose(
        result["follow.theta"], 0.5 - 2.0 * result["shoulder_joint.theta"], atol=1e-9
    )
    assert result["follow.theta"][0] == 0.5


def test_mimic_false_leaves_joints_free(read):
    scene = read(mimic=False)
    assert "follow_mimic" not in scene.edges
    assert "follow_torque" in scene.inputs
    assert "mimics are ignored, since mimic is False: 'follow'" in scene.origin.notes


@pytest.mark.slow
def test_free_base_falls(read):
    scene = read(base="free")
    assert scene.edges["base"].component.name == "free"
    result = scene.compile().simulate((0.0, 0.1), rtol=1e-10)
    momentum_mass = 4.0 + 1.5 + 0.4 + 0.3
    assert momentum_mass == pytest.approx(
        sum(row.value for name, row in scene.parameters.items() if name.endswith("_mass"))
    )
    assert result["base.vz"][-1] == pytest.approx(-0.981, abs=0.2)


def test_gravity_is_a_parameter(read):
    model = read().compile(["g"])
    assert model.kernels.parameter_array()[model.parameters.index("g")] == 9.81


def test_notes_and_names(read):
    origin = read().origin
    assert origin.file.endswith("robot.urdf")
    assert origin.names["joint", "shoulder joint"] == "shoulder_joint"
    assert origin.names["link", "upper-arm"] == "upper_arm"
    assert "not read: 1 <gazebo>, 1 <material>, 1 <transmission>" in origin.notes
    assert any("joint 'shoulder joint' is 'shoulder_joint'" in note for note in origin.notes)
    assert "note: not read: 1 <gazebo>" in read().summary()


def test_visuals_are_kept_by_name_only(read):
    visuals = read().origin.visuals
    assert [(v.node, v.shape) for v in visuals] == [
        ("base_link", "box"),
        ("upper_arm", "cylinder"),
        ("upper_arm", "mesh"),
        ("slider", "sphere"),
    ]
    assert visuals[0].size == (0.2, 0.3, 0.1)
    assert visuals[0].xyz == (0.0, 0.0, 0.05)
    assert visuals[1].size == (0.05, 0.05, 0.4)
    assert (visuals[2].file, visuals[2].size) == ("package://arm/upper.dae", (2.0, 2.0, 2.0))


def test_names_that_clash_get_numbers(read):
    names = ["a b", "a-b", "a.b", "lambda", "9", "ground", "sin", "é", "t"]
    links = "".join(f'<link name="{name}"/>' for name in names)
    joints = "".join(
        f'<joint name="j {i}" type="fixed"><parent link="a b"/><child link="{name}"/></joint>'
        for i, name in enumerate(names)
        if i
    )
    scene = read(f'<robot name="2 r">{links}{joints}</robot>')
    assert scene.name == "robot_2_r"
    assert scene.nodes[:8] == (
        "ground",
        "a_b",
        "a_b_2",
        "a_b_3",
        "lambda_",
        "_9",
        "ground_2",
        "sin_2",
    )
    assert len(scene.nodes) == 1 + len(names)


def test_many_names_alike_take_no_time(read):
    links = "".join(f'<link name="{"é" * (i + 1)}"/>' for i in range(300))
    joints = "".join(
        f'<joint name="{"j" * 50}{i}" type="fixed"><parent link="é"/>'
        f'<child link="{"é" * (i + 1)}"/></joint>'
        for i in range(1, 300)
    )
    assert len(read(f'<robot name="r">{links}{joints}</robot>').edges) == 300


def test_load_takes_the_ending(tmp_path):
    path = tmp_path / "Whole.URDF"
    path.write_text(WHOLE)
    assert cotree.load(path).name == "whole"
    assert cotree.load(str(path)).edges["base"].component.name == "weld"


def test_a_byte_order_mark_is_no_harm(tmp_path):
    path = tmp_path / "bom.urdf"
    path.write_text(WHOLE, encoding="utf-8-sig")
    assert cotree.load(path).name == "whole"


@pytest.mark.parametrize("angles", [(0.3, -1.2, 2.5), (0.0, 0.0, 3.0), (-2.0, 1.5, 0.1)])
def test_rotations_by_their_factors(angles):
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in angles)
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    np.testing.assert_allclose(rotation_rows(angles, 0.0), z @ y @ x, atol=2e-16)


def test_snap_takes_nearly_quarter_turns_as_such():
    assert rotation_rows((0.0, 1.570796325, 0.0), 1e-8) == [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    assert rotation_rows((0.0, 0.0, -6.28), 1e-2) is None
    assert rotation_rows((0.0, 1.570796325, 0.0), 0.0)[0][0] == pytest.approx(1.8e-9, rel=0.01)


@pytest.mark.slow
def test_snap_saves_operations():
    path = ROBOTS / "ur5_robot.urdf"
    plain, snapped = (cotree.read_urdf(path, snap=snap).compile(tunable=[]) for snap in (0, 1e-9))
    assert snapped.operations["rhs"].total < 0.75 * plain.operations["rhs"].total
    y = np.linspace(-1.0, 1.0, len(plain.states))
    # Five frames of the file are off a quarter turn by 5e-12.
    np.testing.assert_allclose(snapped.rhs(0.0, y), plain.rhs(0.0, y), rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_folding_leaves_no_parameters_and_the_same_rates(read):
    scene = read()
    whole, folded = scene.compile(), scene.compile(tunable=[])
    some = scene.compile(["slider_mass"], tunable=["g"])
    assert folded.parameters == ()
    assert set(some.parameters) == {"g", "slider_mass"}
    y = whole.initial_state
    np.testing.assert_allclose(folded.rhs(0.0, y), whole.rhs(0.0, y), rtol=1e-12, atol=1e-12)
    assert folded.operations["rhs"].total < whole.operations["rhs"].total
    assert scene.parameters["slider_mass"].tunable
    with pytest.raises(cotree.ParameterError, match="'slider_mas', which is no parameter; did you"):
        scene.compile(tunable=["slider_mas"])


LINK = (
    '<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'
)


@pytest.mark.parametrize(
    ("body", "base", "message"),
    [
        ('<link name="b"/>', "fixed", "nothing beyond joint 'j' has inertia in the direction of"),
        (LINK, "fixed", ""),
        (LINK, "free", "singular"),
        (
            LINK.replace('x="1"', 'x="0"').replace('y="1"', 'y="0"').replace('zz="1"', 'zz="0"'),
            "fixed",
            "j.theta",
        ),
    ],
)
def test_links_without_inertia_are_refused_where_they_make_it_singular(read, body, base, message):
    scene = read(
        f'<robot name="r"><link name="a"/>{body}<joint name="j" type="revolute">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>',
        base=base,
    )
    if not message:
        assert scene.compile().states == ("j.theta", "j.theta_dot")
        return
    with pytest.raises(cotree.SingularSystemError, match=re.escape(message)):
        scene.compile()


WRONG = [
    # what to replace, by what, how the line at fault begins, what is said of it
    ('<robot name="whole">', "<machine>", None, "not valid XML"),
    ("</robot>", "", None, "not valid XML"),
    ("<robot", "<!DOCTYPE robot><robot", "<robot", "document type declaration"),
    (
        '<?xml version="1.0" encoding="utf-8"?>',
        '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
        "<?xml",
        "document type declaration",
    ),
    ('name="tool"/>', 'name=""/>', '<link name="tool"', "the link has no name"),
    (
        '<link name="tool"/>',
        '<link name="slider"/>',
        '<link name="tool"',
        "link 'slider' is defined twice, first on",
    ),
    ('name="slide" ', 'name="flange" ', '<joint name="flange"', "joint 'flange' is defined twice"),
    ('type="continuous"', 'type="contnuous"', '<joint name="follow"', "did you mean 'continuous'?"),
    ('type="fixed"', "", '<joint name="flange"', "joint 'flange' has no type"),
    ('<child link="tool"/>', '<child link="tol"/>', '<joint name="flange"', "did you mean 'tool'?"),
    (
        '<child link="tool"/>',
        "",
        '<joint name="flange"',
        "<joint> of joint 'flange' has no <child>",
    ),
    (
        '<child link="tool"/>',
        '<child link="slider"/>',
        '<joint name="flange"',
        "link 'slider' is the child of joint 'slide' too",
    ),
    (
        '<link name="tool"/>',
        '<link name="tool"/><link name="lost"/>',
        '<link name="tool"',
        "is the child of a joint",
    ),
    ('<mass value="4.0"/>', "", "<inertial>", "of link 'base_link' has no <mass>"),
    ('<mass value="4.0"/>', '<mass value="-4.0"/>', '<mass value="4.0"', "negative mass -4"),
    (
        '<mass value="4.0"/>',
        '<mass value="nan"/>',
        '<mass value="4.0"',
        "value of <mass> of link 'base_link' is 'nan'",
    ),
    ('<mass value="4.0"/>', '<mass value="1e999"/>', '<mass value="4.0"', "too large"),
    (
        '<mass value="4.0"/>',
        '<mass value="${m}"/>',
        '<mass value="4.0"',
        "run xacro on the file first",
    ),
    ('iyy="0.03"', 'iyy="-0.03"', '<inertia ixx="0.02"', "negative moment of inertia iyy"),
    ('xyz="0 0.4 0"', 'xyz="0 0.4"', '<origin xyz="0 0.4 0"', "has 2 parts: give three numbers"),
    (
        '<axis xyz="1 0 0"/>',
        '<axis xyz="0 0 0"/>',
        '<axis xyz="1 0 0"',
        "axis of joint 'slide' has no length",
    ),
    ('damping="0.7"', 'damping="-0.7"', "<dynamics", "negative damping"),
    (
        '<mimic joint="shoulder joint"',
        '<mimic joint="shoulder"',
        '<joint name="follow"',
        "did you mean 'shoulder joint'?",
    ),
    (
        '<mimic joint="shoulder joint"',
        '<mimic joint="follow"',
        '<joint name="follow"',
        "mimics itself",
    ),
    (
        '<mimic joint="shoulder joint"',
        '<mimic joint="flange"',
        '<joint name="follow"',
        "has no or several coordinates",
    ),
    ("<transmission", "<xacro:macro name='x'/><transmission", "<transmission", "run xacro"),
]


@pytest.mark.parametrize(
    ("old", "new", "begins", "said"), WRONG, ids=[row[3][:30] for row in WRONG]
)
def test_wrong_files_are_refused_with_file_and_line(read, old, new, begins, said):
    assert old in WHOLE
    with pytest.raises(cotree.SceneError) as caught:
        read(WHOLE.replace(old, new, 1))
    message = str(caught.value)
    found = re.match(r".*robot\.urdf:(\d+): ", message)
    assert found, message
    assert said in message
    assert "\n" not in message
    if begins is not None:
        line = WHOLE.count("\n", 0, WHOLE.index(begins)) + 1
        assert int(found[1]) == line, message


def test_circles_are_refused(read):
    ring = "".join(
        f'<joint name="{a}{b}" type="fixed"><parent link="{a}"/><child link="{b}"/></joint>'
        for a, b in ("ab", "ba")
    )
    with pytest.raises(cotree.SceneError, match="form a cycle"):
        read(f'<robot name="r"><link name="a"/><link name="b"/>{ring}</robot>')
    with pytest.raises(cotree.SceneError, match="part of a cycle of joints"):
        read(f'<robot name="r"><link name="c"/><link name="a"/><link name="b"/>{ring}</robot>')


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"\xff\xfe<", r"robot.urdf:1: not a text in UTF-8"),
        (b"<robot>\n\xe9</robot>", r"robot.urdf:2: not a text in UTF-8"),
        (b"", r"robot.urdf:1: not valid XML: no element found"),
        (b"<robot name='r'/>", r"robot.urdf:1: the robot has no links"),
        (b"<r>" * 70, r"nested more than 60 deep"),
        (b"<robot name='" + b"x" * 20_000 + b"'/>", "more than 10000 characters"),
        (b"<a>" + b"<b/>" * 200_001 + b"</a>", "more than 200000 elements"),
    ],
)
def test_texts_that_are_no_robot(tmp_path, data, said):
    path = tmp_path / "robot.urdf"
    path.write_bytes(data)
    with pytest.raises(cotree.SceneError, match=said):
        cotree.read_urdf(path)


def test_files_that_are_not_there_or_too_large(tmp_path):
    with pytest.raises(cotree.SceneError, match="is not a file"):
        cotree.read_urdf(tmp_path / "none.urdf")
    with pytest.raises(cotree.SceneError, match="is not a file"):
        cotree.load(f"{'x' * 5000}.urdf")
    path = tmp_path / "large.urdf"
    with path.open("wb") as file:
        file.truncate(20_000_001)
    with pytest.raises(cotree.SceneError, match="is larger than 20000000 bytes"):
        cotree.read_urdf(path)


def test_entities_of_the_language_are_read(read):
    scene = read(WHOLE.replace("base_link", "base&amp;link"))
    assert scene.origin.names["link", "base&link"] == "base_link"


@pytest.mark.parametrize("options", [{"base": "flying"}, {"mimic": 1}, {"snap": -1}, {"snap": 1}])
def test_wrong_options(read, options):
    with pytest.raises(cotree.SceneError, match=next(iter(options))):
        read(**options)


def test_equations_and_graph_work_too(read):
    scene = read()
    assert formulate(scene, ["slider_mass"], None)[1].states
    assert "shoulder_joint" in scene.graph().summary()
