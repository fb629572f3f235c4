"""Samples against the distributions that they were drawn from."""

import numpy as np
import pytest
from scipy import stats

import cotree
from cotree.errors import Error, ParameterError


@pytest.fixture(scope="module")
def model():
    return cotree.load("slider-pendulum").compile()


@pytest.mark.parametrize("method", ["sobol", "latin", "halton", "random"])
def test_samples_have_the_distribution_and_the_seed_decides_them(model, method):
    given = {"L": ("uniform", 0.9, 1.1), "k": ("normal", 50, 5), "j1.s": ("loguniform", 0.1, 10)}
    drawn = cotree.sample(model, given, 512, method=method, seed=4)
    again = cotree.sample(model, given, 512, method=method, seed=4)
    for name in given:
        np.testing.assert_array_equal(drawn[name], again[name])
    # Of 512 independent points the largest distance of the distribution functions exceeds
    # 1.95 / sqrt(512) with a probability of 0.1 %; the seed is fixed.
    for name, own in (
        ("L", stats.uniform(0.9, 0.2)),
        ("k", stats.norm(50, 5)),
        ("j1.s", stats.loguniform(0.1, 10)),
    ):
        assert stats.kstest(drawn[name], own.cdf).statistic < 1.95 / np.sqrt(512)
    assert drawn.origin["seed"] == 4


def test_spread_points_give_means_far_better_than_independent_ones(model):
    """The mean of x^2 over [0, 1] is 1/3; random points leave some 1e-2 of 1024."""
    for method, error in (("sobol", 1e-4), ("latin", 1e-4), ("halton", 5e-3)):
        x = cotree.sample(model, {"L": ("uniform", 0, 1)}, 1024, method=method, seed=1)["L"]
        assert abs(np.mean(x**2) - 1 / 3) < error


def test_other_distributions(model):
    given = {
        "m1": ("triangular", 1.0, 2.0, 4.0),
        "m2": ("truncated", 5.0, 1.0, 4.5, 6.0),
        "k": ("lognormal", 50.0, 2.0),
        "L": ("relative", 0.2),
        "g": stats.weibull_min(2.0, scale=9.81),
    }
    drawn = cotree.sample(model, given, 1024, seed=1)
    # Means and medians of 1024 spread points agree to some 1e-3 with those of the distributions.
    assert abs(np.mean(drawn["m1"]) - 7 / 3) < 5e-3
    assert drawn["m2"].min() >= 4.5
    assert drawn["m2"].max() <= 6.0
    assert abs(np.median(drawn["k"]) / 50.0 - 1) < 5e-3
    assert abs(np.std(np.log(drawn["k"])) - np.log(2)) < 5e-3
    assert 0.8 <= drawn["L"].min() < 0.801
    assert abs(np.mean(drawn["g"]) - 9.81 * np.sqrt(np.pi) / 2) < 2e-2
    assert list(drawn.to_dataframe().columns) == list(given)


def test_a_scene_tells_its_values_too(model):
    scene = cotree.load("slider-pendulum")
    for source in (scene, model):
        drawn = cotree.sample(source, {"k": ("relative", 0.1)}, 4, seed=1)
        assert (np.abs(drawn["k"] / 50 - 1) <= 0.1).all()
    start = cotree.sample(model, {"j1.s": ("relative", 0.1)}, 4, seed=1)
    assert (np.abs(start["j1.s"] / 0.5 - 1) <= 0.1).all()


def test_without_a_seed_one_is_drawn_and_told(model):
    drawn = cotree.sample(model, {"L": ("relative", 0.1)}, 4)
    again = cotree.sample(model, {"L": ("relative", 0.1)}, 4, seed=drawn.origin["seed"])
    np.testing.assert_array_equal(drawn["L"], again["L"])


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (("unifrom", 1, 2), "unknown kind 'unifrom'; did you mean 'uniform'"),
        (("uniform", 2, 1), "goes from 2 to 1"),
        (("uniform", 1), r'give \("uniform", low, high\)'),
        (("uniform", 1, "a"), "high of the distribution of 'L' is 'a'"),
        (("uniform", 1, np.nan), "is nan"),
        (("loguniform", -1, 2), "must be positive"),
        (("normal", 1, 0), "deviation 0: it must be positive"),
        (("lognormal", 1, 0.5), "a factor above 1"),
        (("triangular", 1, 5, 2), "mode 5 outside 1 to 2"),
        (("truncated", 1, 1, 5, 2), "goes from 5 to 2"),
        (("relative", 0), "share must be positive"),
        (1.0, "give a tuple such as"),
        ("uniform", "give a tuple such as"),
        ((), "give a tuple such as"),
        (stats.norm, "give a tuple such as"),
        (stats.t(-3), "not finite"),
    ],
)
def test_what_is_no_distribution_is_refused(model, given, told):
    with pytest.raises(ParameterError, match=told):
        cotree.sample(model, {"L": given}, 4)


def test_what_cannot_be_drawn_is_refused(model):
    scene, own = cotree.load("slider-pendulum"), {"L": ("relative", 0.1)}
    for arguments, settings, told in (
        ((model, {"LL": ("relative", 0.1)}, 4), {}, "did you mean 'L'"),
        ((scene, {"j1.s": ("relative", 0.1)}, 4), {}, "need a compiled model"),
        ((model, own, 0), {}, "number of members is 0"),
        ((model, own, 2.5), {}, "number of members is 2.5"),
        ((model, {}, 4), {}, "mapping of names to distributions"),
        (("x", own, 4), {}, "a model or a scene first"),
        ((model, own, 4), {"method": "sobl"}, "did you mean 'sobol'"),
        ((model, own, 4), {"seed": -1}, "the seed is -1"),
    ):
        with pytest.raises(Error, match=told):
            cotree.sample(*arguments, **settings)


def test_a_linear_oscillator_with_uniform_stiffness_has_the_mean_of_the_integral():
    """x = cos(sqrt(k) t) has a mean over k in [a, b] in closed form.

    With u = sqrt(k) it is 2 / (b - a) times the integral of u cos(u t).
    """
    scene = cotree.Scene("oscillator")
    scene.parameter("k", 4.0)
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], initial={"s": 1.0})
    scene.edge("body", "rigid_body", "ground", "A", mass=1.0)
    scene.edge("spring", "spring", "ground", "A", stiffness="k")
    model, (a, b), t = scene.compile(["k"]), (1.0, 9.0), np.linspace(0, 5, 11)
    drawn = cotree.sample(model, {"k": ("uniform", a, b)}, 1024, seed=1)
    runs = model.ensemble((0, 5), drawn, t_eval=t, rtol=1e-9, atol=1e-11)

    def primitive(u):
        return u * np.sin(u * t[1:]) / t[1:] + np.cos(u * t[1:]) / t[1:] ** 2

    mean = 2 / (b - a) * (primitive(np.sqrt(b)) - primitive(np.sqrt(a)))
    # Sobol's 1024 scrambled points leave about 1e-5 of the mean of a smooth function.
    np.testing.assert_allclose(runs["j.s"].mean("member")[1:], mean, atol=1e-4)
    # The mean sensitivity is the difference of the ends over the interval, by the same integral.
    ends = (np.cos(np.sqrt(b) * t) - np.cos(np.sqrt(a) * t)) / (b - a)
    slope = runs["d(j.s)"].sel(parameter="k").mean("member")
    np.testing.assert_allclose(slope, ends, atol=1e-3)
    assert runs.attrs["members"].startswith('{"method": "sobol", "seed": 1')
