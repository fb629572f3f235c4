"""Quaternions against scipy's rotations, and against derivatives of the matrix."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cotree.dag import vector
from cotree.dag import vector as rotation
from cotree.dag.derivative import tangents
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag

# Each entry is a few products of numbers of size one.
ROUNDING = {"rtol": 0.0, "atol": 5e-15}


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def _nodes(dag, letter, n):
    return tuple(dag.symbol(letter, i) for i in range(n))


def _values(symbols, numbers):
    return dict(zip(symbols, map(float, numbers), strict=True))


def _of(matrix, values):
    return np.array(evaluate([entry for row in matrix for entry in row], values)).reshape(3, 3)


def _scipy(q):
    """Return SciPy's rotation, whose quaternions end with the scalar."""
    return Rotation.from_quat([q[1], q[2], q[3], q[0]])


def _product(a, b):
    """Multiply two quaternions of numbers, by scalar and vector parts."""
    scalar = a[0] * b[0] - a[1:] @ b[1:]
    return np.array([scalar, *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def _quaternion(turn):
    x, y, z, w = turn.as_quat()
    return np.array([w, x, y, z])


@pytest.mark.parametrize("length", [1.0, 0.3, 7.0, 1e-150])
def test_matrix_of_a_quaternion_of_any_length(dag, rng, length):
    q = _nodes(dag, "x", 4)
    for _ in range(5):
        numbers = rng.normal(size=4)
        numbers *= length / np.linalg.norm(numbers)
        found = _of(rotation.of_quaternion(q), _values(q, numbers))
        np.testing.assert_allclose(found, _scipy(numbers).as_matrix(), **ROUNDING)


def test_product_turns_within_the_turned_frame(dag, rng):
    a, b = _nodes(dag, "x", 4), _nodes(dag, "p", 4)
    first, second = rng.normal(size=4), rng.normal(size=4)
    values = _values(a, first) | _values(b, second)
    product = np.array(evaluate(rotation.quaternion_product(a, b), values))
    expected = (_scipy(first) * _scipy(second)).as_matrix()
    np.testing.assert_allclose(_scipy(product).as_matrix(), expected, **ROUNDING)
    # Lengths multiply.
    assert np.linalg.norm(product) == pytest.approx(
        np.linalg.norm(first) * np.linalg.norm(second), rel=1e-14
    )


def test_quaternion_about_an_axis(dag, rng):
    axis, (angle,) = _nodes(dag, "p", 3), _nodes(dag, "x", 1)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    for turn in (-2.0, 0.0, 0.7, 4.0):
        values = _values(axis, direction) | {angle: turn}
        found = np.array(evaluate(rotation.quaternion_about(axis, angle), values))
        expected = Rotation.from_rotvec(turn * direction).as_matrix()
        np.testing.assert_allclose(_scipy(found).as_matrix(), expected, **ROUNDING)
        # The matrix about an axis is another way to the same.
        by_matrix = _of(rotation.about(axis, angle).matrix, values)
        np.testing.assert_allclose(by_matrix, expected, **ROUNDING)


def test_angles_turn_about_fixed_axes_x_y_z(dag, rng):
    angles = _nodes(dag, "x", 3)
    for _ in range(5):
        numbers = rng.uniform(-3.0, 3.0, size=3)
        found = evaluate(rotation.quaternion_of_angles(angles), _values(angles, numbers))
        expected = Rotation.from_euler("xyz", numbers).as_matrix()  # lower case: fixed axes
        np.testing.assert_allclose(_scipy(found).as_matrix(), expected, **ROUNDING)


@pytest.mark.parametrize("length", [1.0, 0.4, 3.0])
@pytest.mark.parametrize("is_own", [False, True])
def test_turn_is_the_rotation_vector_of_a_change(dag, rng, is_own, length):
    q, d = _nodes(dag, "x", 4), _nodes(dag, "s", 4)
    matrix = rotation.of_quaternion(q)
    slopes = tangents([entry for row in matrix for entry in row], dict(zip(q, d, strict=True)))
    numbers = rng.normal(size=4)
    numbers *= length / np.linalg.norm(numbers)
    values = _values(q, numbers) | _values(d, rng.normal(size=4))  # changes of length too
    turned = _of(matrix, values)
    slope = np.array(evaluate(slopes, values)).reshape(3, 3)
    spin = turned.T @ slope if is_own else slope @ turned.T
    # Some ten products, of numbers up to 1 / length.
    np.testing.assert_allclose(spin, -spin.T, atol=2e-14)
    found = evaluate(rotation.quaternion_turn(q, d, is_own), values)
    np.testing.assert_allclose(found, [spin[2, 1], spin[0, 2], spin[1, 0]], atol=2e-14)


def test_rates_turn_with_the_angular_velocity_in_own_axes_and_keep_the_length(dag, rng):
    q, w = _nodes(dag, "x", 4), _nodes(dag, "s", 3)
    rates = rotation.quaternion_rates(q, w)
    velocity = rng.normal(size=3)
    values = _values(q, rng.normal(size=4)) | _values(w, velocity)
    turn = evaluate(rotation.quaternion_turn(q, rates, is_own=True), values)
    np.testing.assert_allclose(turn, velocity, rtol=1e-14, atol=1e-15)
    along = sum((a * b for a, b in zip(q, rates, strict=True)), dag.zero)
    assert evaluate([along], values)[0] == pytest.approx(0.0, abs=1e-15)
    # The quaternion of a steady turn follows them: q(t) = q(0) exp(w t / 2).
    h, start = 1e-5, np.array([values[entry] for entry in q])
    ahead, behind = (
        _product(start, _quaternion(Rotation.from_rotvec(sign * h * velocity)))
        for sign in (1.0, -1.0)
    )
    # Central differences: h^2 / 6 times the third derivative, and rounding over h.
    slope = (ahead - behind) / (2.0 * h)
    np.testing.assert_allclose(slope, evaluate(rates, values), atol=1e-9)


#: Turns at which each of the four squares is the largest, and half turns, where the scalar is zero.
TURNS = {
    "none": [0.0, 0.0, 0.0],
    "small": [1e-9, 2e-9, -1e-9],
    "scalar": [0.3, -0.5, 0.2],
    "about x": [3.0, 0.1, -0.2],
    "about y": [0.1, -3.0, 0.3],
    "about z": [-0.2, 0.2, 3.1],
    "half about x": [math.pi, 0.0, 0.0],
    "half about y": [0.0, math.pi, 0.0],
    "half about z": [0.0, 0.0, math.pi],
    "third about a diagonal": [2 * math.pi / 3 / math.sqrt(3)] * 3,
}


def _same_up_to_sign(found, expected, atol):
    found = np.asarray(found, dtype=float)
    np.testing.assert_allclose(found * np.sign(found @ expected), expected, rtol=0.0, atol=atol)


@pytest.mark.parametrize("name", TURNS)
def test_quaternion_of_a_matrix_of_numbers(name):
    turn = Rotation.from_rotvec(TURNS[name])
    found = rotation.quaternion_of_matrix(turn.as_matrix().tolist())
    assert found is not None
    # The largest component is at least a half, so that nothing small is divided by.
    _same_up_to_sign(found, _quaternion(turn), 2e-15)


@pytest.mark.parametrize("name", TURNS)
def test_quaternion_of_a_matrix_of_nodes(dag, name):
    entries = _nodes(dag, "x", 9)
    turn = Rotation.from_rotvec(TURNS[name])
    values = _values(entries, turn.as_matrix().ravel())
    rows = (entries[:3], entries[3:6], entries[6:])
    nodes = rotation.quaternion_of_nodes(rows, lambda node: evaluate([node], values)[0])
    _same_up_to_sign(evaluate(nodes, values), _quaternion(turn), 2e-15)


def test_quaternion_of_nodes_holds_near_the_values_that_chose_it(dag):
    # The formula is chosen once; derivatives are those of the quaternion of the moving matrix.
    angle = dag.symbol("x", 0)
    axis = (dag.zero, dag.one, dag.zero)
    matrix = rotation.about(axis, angle).matrix
    for at in (0.4, 2.9):
        values = {angle: at}
        q = rotation.quaternion_of_nodes(matrix, lambda node, v=values: evaluate([node], v)[0])
        turn = rotation.quaternion_turn(q, tangents(q, {angle: dag.one}), is_own=False)
        np.testing.assert_allclose(evaluate(turn, values), [0.0, 1.0, 0.0], atol=2e-15)


@pytest.mark.parametrize(
    "rows",
    [
        np.zeros((3, 3)),
        -np.eye(3),  # a point reflection
        np.diag([1.0, 1.0, -1.0]),
        2.0 * np.eye(3),
        np.eye(3) + 1e-4,
        np.full((3, 3), math.nan),
        np.full((3, 3), math.inf),
    ],
)
def test_what_is_no_rotation_has_no_quaternion(rows):
    assert rotation.quaternion_of_matrix(rows.tolist()) is None


def test_a_matrix_printed_with_seven_digits_is_a_rotation():
    turn = Rotation.from_rotvec([0.3, -1.2, 2.0])
    rows = np.round(turn.as_matrix(), 7)
    found = rotation.quaternion_of_matrix(rows.tolist())
    assert found is not None
    _same_up_to_sign(found, _quaternion(turn), 1e-7)
    assert math.hypot(*found) == pytest.approx(1.0, rel=1e-15)


def test_the_unit_quaternion_folds_away():
    dag = Dag()
    unit = (dag.one, dag.zero, dag.zero, dag.zero)
    other = _nodes(dag, "x", 4)
    assert rotation.quaternion_product(unit, other) == other
    assert rotation.quaternion_product(other, unit) == other
    assert rotation.of_quaternion(unit) == vector.identity(dag)
