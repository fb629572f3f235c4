"""Random scenes for property tests: trees of bodies, spatial and planar, and closed loops."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
from newton_euler import NewtonEuler
from scene_gaps import RANK
from scene_kinematics import COORDINATES, RATES, turn

from cotree import Scene
from cotree.components import COMPONENTS
from cotree.scene.expressions import parse

PLANAR_JOINTS = ("revolute", "prismatic")
JOINTS = (*PLANAR_JOINTS, "cylindrical")
LOOP_JOINTS = (*JOINTS, "universal", "spherical", "screw")
EVERY_JOINT = (*LOOP_JOINTS, "planar", "free")

#: Directions that each chord reacts in.
CLOSING = {"spherical": 3, "universal": 4, "cylindrical": 4, "revolute": 5, "prismatic": 5}
CLOSING |= {"planar": 3, "screw": 5, "distance": 1, "slot": 2}


def vector(rng: random.Random) -> list[float]:
    return [round(rng.uniform(-1.0, 1.0), 3) for _ in range(3)]


def inertia(rng: random.Random) -> list[list[float]]:
    """A physical inertia tensor: that of a few point masses, plus a little of a ball."""
    tensor = [[0.02 * (i == j) for j in range(3)] for i in range(3)]
    for _ in range(4):
        mass, at = rng.uniform(0.1, 1.0), vector(rng)
        square = sum(c * c for c in at)
        for i in range(3):
            for j in range(3):
                tensor[i][j] += mass * (square * (i == j) - at[i] * at[j])
    return [[tensor[min(i, j)][max(i, j)] for j in range(3)] for i in range(3)]


def random_scene(seed: int, n_joints: int = 4, *, is_planar: bool = False) -> Scene:
    """A random tree of bodies with springs, dampers, forces and torques between its nodes."""
    rng = random.Random(seed)
    scene = _new_scene(f"random-{seed}")
    ends = ["ground"]
    for i in range(n_joints):
        _add_body(scene, rng, i, rng.choice(ends), is_planar)
        ends.append(f"C{i}")
        ends.append(f"B{i}")
    _add_forces(scene, rng, ends, _first(scene))
    return scene


def _add_body(scene: Scene, rng: random.Random, i: int, parent: str, is_planar: bool) -> None:
    kind = rng.choice(PLANAR_JOINTS if is_planar else JOINTS)
    axis = vector(rng)
    if is_planar:
        axis = [0, 0, 1] if kind == "revolute" else [axis[0], axis[1], 0]
    hinge = f"A{i}"
    scene.edge(f"r{i}", "arm", parent, hinge, vector=[f"a*{v}" for v in vector(rng)])
    nodes = [hinge, f"B{i}"]
    if rng.random() < 0.5:
        nodes.reverse()
    names = [freedom.name for freedom in COMPONENTS[kind].motion_space]
    initial = {f"{name}{dot}": rng.uniform(-1, 1) for name in names for dot in ("", "_dot")}
    if not is_planar:
        axis = [f"{axis[0]} + a", *axis[1:]]  # parameters may turn an axis
    fields = {"axis": axis}
    if kind in PLANAR_JOINTS:
        drive = "torque" if kind == "revolute" else "force"
        fields |= {"damping": "b*0.1", "stiffness": 0.5, drive: "0.3*u1"}
    scene.edge(f"j{i}", kind, *nodes, initial=initial, **fields)
    arm = [f"B{i}", f"C{i}"]
    if rng.random() < 0.5:
        arm.reverse()
    scene.edge(f"c{i}", "arm", *arm, vector=[f"b*{v}" for v in vector(rng)])
    tensor = [[f"b*{entry!r}" for entry in row] for row in inertia(rng)]
    scene.edge(f"m{i}", "rigid_body", "ground", f"C{i}", mass=f"a+{i}", inertia=tensor)


def _add_forces(scene: Scene, rng: random.Random, ends: list[str], first: tuple[str, str]) -> None:
    """Springs, dampers, a force and a torque, the last two by what ``first`` names too."""
    pairs = [rng.sample(ends, 2) for _ in range(6)]
    scene.edge("f0", "spring", *pairs[0], stiffness="3*a", free_length=0.4, damping=0.2)
    scene.edge(
        "f1", "spring", *pairs[1], axis=vector(rng), stiffness=2.0, free_length="0.1*b", damping="a"
    )
    scene.edge("f2", "damper", *pairs[2], damping="0.4*b")
    scene.edge("f3", "damper", *pairs[3], axis=vector(rng), damping=0.7)
    scene.edge("f4", "force", *pairs[4], force=["a*sin(t)", 0.3, f"u1*{first[0]}"])
    scene.edge("f5", "torque", *pairs[5], torque=[0.1, "b", first[1]])
    scene.output("x", f"{ends[-1]}.x + 2*{ends[-2]}.vz*a")
    scene.output("y", f"{ends[-1]}.vy*{ends[-1]}.z")


def _first(scene: Scene) -> tuple[str, str]:
    """Name the first coordinate and the first rate of the first joint."""
    kind = scene.edges["j0"].component.name
    return f"j0.{COORDINATES[kind][0]}", f"j0.{RATES[kind][0]}"


def random_mechanism(
    seed: int, n_bodies: int | None = None, *, has_joint_laws: bool = True
) -> Scene:
    """A random tree of bodies with every type of joint, turned arms, springs and drives.

    Without ``has_joint_laws`` nothing depends on the joints' coordinates, so that these may be
    chords.
    """
    rng = random.Random(seed)
    scene = _new_scene(f"mechanism-{seed}")
    ends = ["ground"]
    # The first joints of successive seeds go through all types.
    kinds = [EVERY_JOINT[seed % len(EVERY_JOINT)]]
    kinds += rng.choices(EVERY_JOINT, k=(n_bodies or rng.randint(2, 5)) - 1)
    for i, kind in enumerate(kinds):
        parent, initial = rng.choice(ends), _random_state(rng, kind)
        _add_link(scene, rng, i, parent, kind, initial, has_law=has_joint_laws)
        ends += [f"C{i}", f"B{i}"]
    _add_forces(scene, rng, ends, _first(scene) if has_joint_laws else ("u1", "a"))
    return scene


def random_loop(
    seed: int, *, is_planar: bool = False, has_joint_laws: bool = True
) -> tuple[Scene, list[str]]:
    """A random chain whose last body is tied to the ground or to the first body.

    Without ``has_joint_laws`` any joint may be the chord.

    Returns
    -------
    scene : Scene
        Its initial state closes the loop, with rates that keep it closed.
    branches : list of str
        The tree that has the tie as a chord.
    """
    for variant in range(seed, seed + 10_000, 1_000):
        tie = PLANAR_JOINTS[seed % 2] if is_planar else [*CLOSING][seed % len(CLOSING)]
        given = (variant, tie, is_planar, has_joint_laws)
        oracle = NewtonEuler(*_loop({}, *given))
        if (state := _closed_state(oracle, variant)) is not None:
            return _loop(dict(zip(oracle.states, state.tolist(), strict=True)), *given)
    raise ValueError(f"seed {seed} closes nowhere far from singular: take another")


def restarted(scene: Scene, oracle: NewtonEuler, state: np.ndarray) -> Scene:
    """The scene with a state of another tree as its initial state: chords have none."""
    copy = Scene(scene.name)
    vars(copy).update(vars(scene), edges={})
    value_by_state = dict(zip(oracle.states, np.asarray(state).tolist(), strict=True))
    for name, edge in scene.edges.items():
        own = [full for full in oracle.states if full.startswith(f"{name}.")]
        initial = {full.partition(".")[2]: parse(value_by_state[full], full) for full in own}
        copy.edges[name] = replace(edge, initial=initial)
    return copy


def _closed_state(oracle: NewtonEuler, seed: int) -> np.ndarray | None:
    """A closed state near rest, where there is one far from singular."""
    for attempt in range(6):
        size = np.repeat([0.4, 1.0], [len(oracle.coordinates), len(oracle.rates)])
        start = size * np.random.default_rng((seed, attempt)).uniform(-1.0, 1.0, len(size))
        try:
            state = oracle.consistent(oracle.rest + start)
        except ValueError:
            continue
        if _is_well_posed(oracle, state):
            return np.array(state)
    return None


def _is_well_posed(oracle: NewtonEuler, state: np.ndarray) -> bool:
    """Whether the tie is far from singular and leaves the chain some motion."""
    sizes = np.linalg.svd(oracle.jacobian(oracle.split(state)[0], 0.0), compute_uv=False)
    held = sizes[sizes > RANK * sizes[0]]
    return bool(held[-1] > 0.05 * sizes[0] and len(held) < len(oracle.rates))


def _loop(
    state: dict[str, float], seed: int, tie: str, is_planar: bool, has_law: bool
) -> tuple[Scene, list[str]]:
    """A chain with a tie that is closed where all coordinates are zero."""
    rng = random.Random(seed)
    scene = _new_scene(f"loop-{seed}", is_planar)
    kinds, anchor = _loop_joints(rng, tie, is_planar)
    for i, kind in enumerate(kinds):
        names = {name: f"j{i}.{name}" for name in (*COORDINATES[kind], *RATES[kind])}
        initial = {name: state[full] for name, full in names.items() if full in state}
        _add_link(scene, rng, i, f"B{i - 1}" if i else "ground", kind, initial, is_planar, has_law)
    _add_tie(scene, rng, tie, anchor, f"B{len(kinds) - 1}", is_planar)
    ends = [f"{letter}{i}" for i in range(len(kinds)) for letter in "BC"]
    pairs = [rng.sample(ends, 2) for _ in range(3)]
    scene.edge("f0", "spring", *pairs[0], stiffness="3*a", free_length=0.4, damping=0.2)
    scene.edge("f1", "damper", "ground", pairs[1][0], damping="0.4*b", axis=[1.0, 0.3, 0])
    scene.edge("f2", "force", *pairs[1], force=["a*sin(t)", "0.3*u1", 0])
    scene.edge("f3", "torque", *pairs[2], torque=[0, 0, "b"])
    scene.output("x", f"{ends[-1]}.x + 2*{ends[-2]}.vy*a")
    return scene, _branches(scene)


def _branches(scene: Scene) -> list[str]:
    """All joints and arms but the tie."""
    return [n for n, e in scene.edges.items() if n != "tie" and e.component.name in COORDINATES]


def _loop_joints(rng: random.Random, tie: str, is_planar: bool) -> tuple[list[str], str]:
    """Choose joints that leave the loop a freedom, and the node that the tie starts from."""
    if is_planar:
        return ["revolute", *rng.choices(PLANAR_JOINTS, k=rng.randint(1, 2)), "revolute"], "ground"
    kinds, freedoms = [], 0
    # Tied to its first body, the chain moves as a whole by the first joint, outside the loop.
    anchor = rng.choice(["ground", "B0"])
    while freedoms <= CLOSING[tie] or len(kinds) < 3:
        kinds.append(rng.choice(LOOP_JOINTS))
        if anchor == "ground" or len(kinds) > 1:
            freedoms += len(RATES[kinds[-1]])
    return kinds, anchor


def _add_tie(
    scene: Scene, rng: random.Random, tie: str, anchor: str, last: str, is_planar: bool
) -> None:
    """Tie a chain's last node to an anchor by an arm that reaches it in the chain's rest."""
    oracle = NewtonEuler(scene, _branches(scene))
    places = oracle.places(oracle.split(oracle.rest)[0])
    turned, reach = places.relative(*(oracle.place_of[node] for node in (last, anchor)))
    fields = _joint_fields(rng, tie, is_planar)
    if not is_planar:  # the angle of a chord is only known within half a turn: no spring about it
        fields.pop("stiffness", None)
    if tie == "distance":
        gap = np.array(vector(rng))
        reach, fields = reach + turned @ gap, {"length": float(np.linalg.norm(gap))}
    rotation = {} if is_planar else {"rotation": turned.tolist()}
    scene.edge("reach", "arm", last, "E", vector=reach.tolist(), **rotation)
    nodes = [anchor, "E"]
    if rng.random() < 0.5:
        nodes.reverse()
    scene.edge("tie", tie, *nodes, **fields)


def _add_link(
    scene: Scene,
    rng: random.Random,
    i: int,
    parent: str,
    kind: str,
    initial: dict[str, float],
    is_planar: bool = False,
    has_law: bool = True,
) -> None:
    """A body on a joint, with an arm before and after it."""
    _add_arm(scene, rng, f"r{i}", [parent, f"A{i}"], is_planar)
    nodes = [f"A{i}", f"B{i}"]
    if rng.random() < 0.5:
        nodes.reverse()
    fields = _joint_fields(rng, kind, is_planar)
    drive = {"revolute": "torque", "prismatic": "force", "screw": "torque"}.get(kind)
    if drive and has_law and rng.random() < 0.5:
        fields |= {"damping": "b*0.1", "stiffness": 0.5, drive: "0.3*u1"}
    scene.edge(f"j{i}", kind, *nodes, initial=initial, **fields)
    arm = [f"B{i}", f"C{i}"]
    if rng.random() < 0.5:
        arm.reverse()
    _add_arm(scene, rng, f"c{i}", arm, is_planar)
    tensor = [[f"b*{entry!r}" for entry in row] for row in inertia(rng)]
    of_body = ["0.3*b", 0.4, "0.5*a"] if is_planar else tensor
    scene.edge(f"m{i}", "rigid_body", "ground", f"C{i}", mass=f"a+{i}", inertia=of_body)


def _add_arm(
    scene: Scene, rng: random.Random, name: str, nodes: list[str], is_planar: bool
) -> None:
    """An arm that may turn its second node: by roll, pitch and yaw, or by a matrix."""
    x, y, z = vector(rng)
    angles, choice = vector(rng), rng.random()
    fields = {}
    if not is_planar and choice < 0.3:
        fields["rotation"] = [angles[0], f"a*{angles[1]}", angles[2]]
    elif not is_planar and choice < 0.5:
        fields["rotation"] = turn(angles, 1.1).tolist()
    reach = [f"a*{x}", f"a*{y}", 0 if is_planar else f"a*{z}"]
    scene.edge(name, "arm", *nodes, vector=reach, **fields)


def _joint_fields(rng: random.Random, kind: str, is_planar: bool) -> dict[str, object]:
    """Axes of a joint, and the pitch of a screw."""
    x, y, z = vector(rng)
    if is_planar:
        return {"axis": [0, 0, 1] if kind == "revolute" else [x, y, 0]}
    fields: dict[str, object] = {}
    if kind == "planar":
        fields["normal"] = rng.choice([[1, 0, 0], [0, 1, 0], [0, 0, 1]])
    elif kind not in ("spherical", "free", "distance"):
        fields["axis"] = [f"{x} + a", y, z]  # parameters may turn an axis
    if kind == "universal":
        fields["axis2"] = vector(rng)
    if kind == "screw":
        fields["pitch"] = "0.3*a"
    return fields


def _random_state(rng: random.Random, kind: str) -> dict[str, float]:
    """Coordinates and rates between -1 and 1; quaternions of unit length."""
    state = {name: rng.uniform(-1.0, 1.0) for name in (*COORDINATES[kind], *RATES[kind])}
    turning = [name for name in COORDINATES[kind] if name.startswith("q")]
    length = np.linalg.norm([state[name] for name in turning])
    return state | {name: float(state[name] / length) for name in turning}


def _new_scene(name: str, is_planar: bool = False) -> Scene:
    scene = Scene(name, gravity=["g*0.3", "-g", 0 if is_planar else "0.2*g"])
    scene.parameter("g", 9.81)
    scene.parameter("a", 0.7)
    scene.parameter("b", 1.3)
    scene.input("u1", "sin(t)")
    return scene


def _first(scene: Scene) -> tuple[str, str]:
    """Name the first coordinate and the first rate of the first joint."""
    kind = scene.edges["j0"].component.name
    return f"j0.{COORDINATES[kind][0]}", f"j0.{RATES[kind][0]}"
