"""Poses over a run: against closed forms, against outputs of the compiled model, and in loops."""

from __future__ import annotations

import jointed_scenes
import numpy as np
import pytest
from readme_linkage import four_bar

from cotree import Scene, load
from cotree.errors import SceneError
from cotree.watch import shapes
from cotree.watch.catalogue import body_box
from cotree.watch.frame_times import MOST_FRAMES, choose_frames, coordinates_at
from cotree.watch.stage import MotionValues

Z = [0, 0, 1]


def points_of(model, result, times):
    """Return positions, shape (n_times, 3), and axes of every node at some times."""
    first, p = model.spec.formed.first, model.kernels.parameter_array(result.parameter_values)
    coordinates = coordinates_at(result, model, first.system, p, times)
    values = MotionValues(first.motion, p, times, coordinates)
    poses, found = values.poses(), {}
    for name, point in first.motion.clusters.points.items():
        place = values.place(point)
        axes = poses.axes[place.cluster] @ place.turn
        found[name] = (poses.of(place.cluster, place.local), axes)
    return found


def test_slider_pendulum_is_where_its_coordinates_put_it():
    model = load("slider-pendulum").compile()
    result = model.simulate((0, 4))
    found = points_of(model, result, result.t)
    s, theta = result["j1.s"], result["h2.theta"]
    rod = np.column_stack([s + 0.5 * np.sin(theta), -0.5 * np.cos(theta), 0 * s])
    # Rounding of a few operations.
    np.testing.assert_allclose(found["C"][0], rod, atol=1e-14)
    np.testing.assert_allclose(found["D"][0], np.column_stack([s, 0 * s, 0 * s]), atol=1e-15)
    np.testing.assert_allclose(found["C"][1][:, 0, 1], -np.sin(theta), atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("tree", [jointed_scenes.CHAIN_TREE, jointed_scenes.BODY_TREE])
def test_spatial_chain_is_where_its_outputs_say(tree):
    """Outputs are formed symbolically in ground axes and computed in C: another route."""
    scene = jointed_scenes.spatial_chain("distance")
    for i, j in np.ndindex(3, 3):
        scene.output(f"r{i}{j}", f"R2.r{i + 1}{j + 1}")
    for axis in "xyz":
        scene.output(f"p{axis}", f"Q2.{axis}")
    model = scene.compile(tree=tree, optimize="-O0")
    result = model.simulate((0, 1))
    found = points_of(model, result, result.t)
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(found["Q2"][0][:, k], result[f"p{axis}"], atol=1e-12)
    for i, j in np.ndindex(3, 3):
        np.testing.assert_allclose(found["R2"][1][:, i, j], result[f"r{i}{j}"], atol=1e-12)


def test_loop_stays_closed_between_the_points_of_a_run():
    model = four_bar().compile()
    result = model.simulate((0, 10))
    found = points_of(model, result, np.linspace(0, 10, 501))
    gaps = {pair: found[pair[0]][0] - found[pair[1]][0] for pair in (("B", "B2"), ("C", "C2"))}
    for gap in gaps.values():
        # A tenth of a pixel of a picture of the linkage; measured 4e-9.
        assert np.abs(gap).max() < 1e-6


def test_path_between_two_points_is_exact_for_a_quintic():
    """s = t^5 / 20 under a force of t^3: value, rate and acceleration at both ends fix it."""
    scene = Scene("jerky")
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force="t**3")
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    model = scene.compile(optimize="-O0")
    result = model.simulate((0, 2), [0.0, 2.0], rtol=1e-12, atol=1e-14)
    times = np.linspace(0, 2, 21)
    found = points_of(model, result, times)["A"][0][:, 0]
    # As exact as the run itself.
    np.testing.assert_allclose(found, times**5 / 20, atol=1e-10)


@pytest.mark.parametrize("axis", [[0, 0, 1], [1, 2, -2]])
def test_free_turn_about_an_axis_keeps_its_rate_and_norm(axis):
    """Unit inertia: the body turns by w t about w; 40 points for four turns are ten a turn."""
    w = 2 * np.pi * 2.0
    unit = np.array(axis) / np.linalg.norm(axis)
    scene = Scene("spin")
    initial = {f"w{i + 1}": float(w * unit[i]) for i in range(3)}
    scene.edge("f", "spherical", "ground", "A", initial=initial)
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0, inertia=[1.0, 1.0, 1.0])
    model = scene.compile(optimize="-O0")
    result = model.simulate((0, 2), np.linspace(0, 2, 41), rtol=1e-10, atol=1e-12)
    times = np.linspace(0, 2, 333)
    axes = points_of(model, result, times)["A"][1]
    identity = np.broadcast_to(np.eye(3), axes.shape)
    np.testing.assert_allclose(axes @ np.swapaxes(axes, 1, 2), identity, atol=1e-12)
    k = np.cross(unit, np.eye(3)).T  # the cross product as a matrix
    c, s = np.cos(w * times)[:, None, None], np.sin(w * times)[:, None, None]
    exact = np.eye(3) + s * k + (1 - c) * (k @ k)  # Rodrigues
    # Entries of the quaternion go with w / 2, so that the error is (0.31)^6 / 46080 = 2e-8.
    np.testing.assert_allclose(axes, exact, atol=1e-7)


def test_events_are_not_smoothed():
    """The ball flies on parabolas, which the interpolation repeats up to each bounce."""
    model = load("bouncing-ball").compile()
    result = model.simulate((0, 2.5), rtol=1e-10, atol=1e-12)
    times = np.linspace(0, 2.5, 401)
    found = points_of(model, result, times)["B"][0][:, 2]
    hit = np.sqrt(2 * 2.0 / 9.81)
    first, speed = times < hit, 0.8 * 9.81 * hit
    second = (times > hit) & (times < hit + 2 * speed / 9.81)
    np.testing.assert_allclose(found[first], 2 - 0.5 * 9.81 * times[first] ** 2, atol=1e-9)
    since = times[second] - hit
    np.testing.assert_allclose(found[second], speed * since - 0.5 * 9.81 * since**2, atol=1e-8)


def test_runs_backwards_and_of_one_point_are_shown():
    model = load("spring-mass-damper").compile()
    back = model.simulate((2, 0))
    times = back.animate().drawing.frames.times
    assert times[0] == 2.0
    assert times[-1] == 0.0
    alone = model.simulate((0, 1), [0.5])
    assert alone.animate().drawing.frames.times.tolist() == [0.5]


def test_frames_are_even_and_bounded():
    frames = choose_frames(0.0, 10.0, 25.0, None)
    assert len(frames.times) == 251
    assert frames.pause == pytest.approx(0.04)
    assert frames.speed == pytest.approx(1.0)
    slow = choose_frames(0.0, 0.004, 25.0, None)
    assert slow.speed == pytest.approx(0.0005)  # 8 s of watching
    assert choose_frames(0.0, 1e6, 25.0, None).speed == pytest.approx(1e5)
    long = choose_frames(0.0, 1e4, 25.0, 1.0)
    assert len(long.times) == MOST_FRAMES
    assert long.speed == pytest.approx(1.0)
    assert len(choose_frames(0.0, 1e4, 25.0, 1.0, n_bodies=1000).times) == 300


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"fps": 0}, "fps"),
        ({"fps": 1e9}, "fps"),
        ({"fps": "x"}, "fps"),
        ({"speed": 0}, "speed"),
        ({"speed": 1e-300}, "larger"),
        ({"speed": float("nan")}, "speed"),
        ({"view": 3}, "view"),
        ({"view": (1, "x")}, "elevation"),
    ],
)
def test_settings_without_sense_are_refused(settings, told):
    result = load("slider-pendulum").compile().simulate((0, 0.1))
    with pytest.raises(ValueError, match=told):
        result.animate(**settings)


def test_failed_run_is_shown_up_to_where_it_got():
    model = load("slider-pendulum").compile()
    with pytest.warns(RuntimeWarning, match="step"):
        result = model.simulate((0, 10), max_steps=20)
    animation = result.animate()
    assert animation.drawing.frames.times[-1] == result.t[-1]
    assert "stopped early" in animation.drawing.note


def test_states_that_are_no_numbers_are_left_out():
    model = load("slider-pendulum").compile()
    result = model.simulate((0, 1), np.linspace(0, 1, 11))
    result.y[0, 6:] = np.nan
    assert result.animate().drawing.frames.times[-1] == result.t[5]
    result.y[0, 3] = 1e200  # nor what runs away
    assert result.animate().drawing.frames.times[-1] == result.t[2]
    result.y[0, 0] = np.inf
    with pytest.raises(SceneError, match="no point"):
        result.animate()


def test_prescribed_motion_and_changed_parameters_are_those_of_the_run():
    scene = Scene("driven")
    scene.parameter("L", 1.0)
    scene.edge("h", "revolute", "ground", "A", axis=Z, motion="2*t")
    scene.edge("rod", "arm", "A", "B", vector=["L", 0, 0])
    scene.edge("m", "rigid_body", "ground", "B", mass=1.0, inertia=0.1)
    model = scene.compile(optimize="-O0")
    result = model.simulate((0, 1), parameters={"L": 3.0})
    times = np.linspace(0, 1, 11)
    found = points_of(model, result, times)["B"][0]
    exact = 3.0 * np.column_stack([np.cos(2 * times), np.sin(2 * times), 0 * times])
    np.testing.assert_allclose(found, exact, atol=1e-6)  # the run's tolerance is 1e-8


def test_body_box_has_the_inertia_of_the_body():
    lengths, axes = body_box(2.0, np.diag([2 * (9 + 16) / 12, 2 * (4 + 16) / 12, 2 * 13 / 12]))
    np.testing.assert_allclose(lengths, [2, 3, 4], rtol=1e-14)
    np.testing.assert_array_equal(axes, np.eye(3))
    assert body_box(1.0, np.zeros((3, 3))) is None


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (shapes.box(1, 2, 3), 6.0),
        (shapes.cylinder(1, 2), 2 * np.pi),
        (shapes.sphere(1), 4 / 3 * np.pi),
        (shapes.capsule(1, 2), 10 / 3 * np.pi),
        (shapes.plate(1, 2, 0.5), 0.5 * (np.pi + 4)),
        (shapes.ring(1, 0.5, 2), 1.5 * np.pi),
        (shapes.rod(1), np.pi),
        (shapes.box(1, 2, 3).scaled([-1, 1, 2]), 12.0),
    ],
)
def test_shapes_are_closed_and_face_outwards(mesh, volume):
    a, b, c = (mesh.points[mesh.faces[:, i]] for i in range(3))
    found = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    # 28 sides in place of a circle take a hundredth, half as many rows of a sphere two.
    assert found == pytest.approx(volume, rel=0.03)


def test_rail_of_a_slot_is_as_long_as_the_way():
    """The axis of a slot need not have length one, and may be written with a factor of time."""
    scene = Scene("slot")
    scene.parameter("b", 0.0)
    scene.edge("f", "planar", "ground", "A", normal=Z, initial={"x_dot": 2.0})
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0, inertia=1.0)
    scene.edge("line", "slot", "ground", "A", axis=[5.0, "b*t", 0])
    drawing = scene.compile(optimize="-O0").simulate((0, 2)).animate().drawing
    rail = next(row for row in drawing.solids if row.name == "line" and row.track == 0)
    # Four widths more at each end.
    length = 4.0 + 8.0 * drawing.thickness
    assert np.ptp(rail.mesh.points[:, 0]) == pytest.approx(length, rel=1e-6)
