"""Pictures of ensembles show what the Dataset holds."""

import matplotlib
import numpy as np
import pytest

import cotree
from cotree.errors import SceneError
from cotree.plot.ensembles import picture


@pytest.fixture(scope="module")
def model():
    return cotree.load("slider-pendulum").compile(["L"])


@pytest.fixture(scope="module")
def drawn(model):
    members = cotree.sample(model, {"L": ("relative", 0.1), "k": ("relative", 0.1)}, 64, seed=1)
    return model.ensemble((0, 2), members, t_eval=21)


@pytest.fixture(scope="module")
def gridded(model):
    with pytest.warns(RuntimeWarning, match="3 of 12 members failed"):
        return model.ensemble((0, 2), cotree.grid(m1=[-1, 1, 2, 4], k=[10, 50, 100]), t_eval=21)


def test_the_median_and_the_bands_are_quantiles_over_the_members(drawn):
    figure = cotree.bands(drawn, ["j1.s", "d(j1.s)/d(L)"])
    first, second = figure.axes
    np.testing.assert_allclose(first.lines[0].get_ydata(), drawn["j1.s"].median("member"))
    np.testing.assert_allclose(
        second.lines[0].get_ydata(), drawn["d(j1.s)"].sel(parameter="L").median("member")
    )
    heights = first.collections[0].get_paths()[0].vertices[:, 1]
    last = drawn["j1.s"].isel(time=-1).quantile([0.025, 0.975]).values
    assert np.min(np.abs(heights - last[0])) < 1e-12
    assert np.min(np.abs(heights - last[1])) < 1e-12
    assert second.get_ylabel() == "∂ j1.s / ∂ L [m/m]"


def test_a_heat_map_has_a_cell_for_each_member_and_leaves_out_failed_ones(gridded):
    figure = cotree.heat_map(gridded, "j1.s", of="max")
    shown = figure.axes[0].collections[0].get_array()
    np.testing.assert_array_equal(np.ma.filled(shown, np.nan), gridded["j1.s"].max("time"))
    assert np.ma.getmaskarray(shown).sum() == 3
    assert figure.axes[0].get_xlabel() == "k [N/m]"
    at = cotree.heat_map(gridded, "d(j1.s)/d(L)", time=1.04).axes
    assert at[1].get_ylabel() == "∂ j1.s / ∂ L [m/m] at 1 s"


def test_curves_are_coloured_by_a_column(drawn):
    figure = cotree.curves(drawn, "j1.s", color_by="k")
    assert len(figure.axes[0].lines) == 64
    colors = [line.get_color() for line in figure.axes[0].lines]
    least = int(np.argmin(drawn["k"].values))
    np.testing.assert_allclose(colors[least], matplotlib.colormaps["viridis"](0.0))


def test_what_fits_is_drawn(model, drawn, gridded):
    line = model.ensemble((0, 1), cotree.grid(L=[0.9, 1.1]), t_eval=5)
    assert len(picture(drawn, ["j1.s"]).axes) == 1
    assert picture(gridded, ["j1.s"]).axes[0].get_ylabel() == "m1 [kg]"
    assert len(picture(line, ["j1.s"]).axes[0].lines) == 2


def test_parts_of_a_dataset_and_own_variables_are_drawn(drawn, gridded):
    energy = drawn.assign(energy=drawn["j1.s_dot"] ** 2)
    assert len(cotree.bands(energy[["energy"]]).axes) == 1
    peaks = gridded.assign(peak=gridded["j1.s"].max("time"))
    assert cotree.heat_map(peaks, "peak").axes[1].get_ylabel().startswith("peak")
    cotree.bands(gridded.sel(m1=2), "j1.s")


@pytest.mark.parametrize(
    ("draw", "told"),
    [
        (lambda d, g: cotree.bands(d, "j1.z"), "did you mean 'j1.s'"),
        (lambda d, g: cotree.bands(d, "d(j1.s)"), r"name one, 'd\(j1.s\)/d\(L\)'"),
        (lambda d, g: cotree.bands(d, "d(j1.s)/d(m1)"), "no sensitivities to 'm1'"),
        (lambda d, g: cotree.bands(d, []), "there are no names of variables"),
        (lambda d, g: cotree.bands(d, "status"), "not a curve over time"),
        (lambda d, g: cotree.bands(d["j1.s"]), "a DataArray cannot be drawn"),
        (lambda d, g: cotree.bands(None), "a NoneType cannot be drawn"),
        (lambda d, g: cotree.bands(g.isel(m1=[0])), "all members failed"),
        (lambda d, g: cotree.heat_map(g.isel(m1=[0])), "all members failed"),
        (lambda d, g: cotree.heat_map(d, "j1.s"), "needs a grid of two dimensions"),
        (lambda d, g: cotree.heat_map(g, "j1.s", time=3), "runs go from 0 to 2 s"),
        (lambda d, g: cotree.heat_map(g, "j1.s", of="sum"), "give 'last', 'max', 'min' or 'mean'"),
        (lambda d, g: cotree.curves(d, "j1.s", color_by="kk"), "did you mean 'k'"),
    ],
)
def test_what_cannot_be_drawn_is_refused(drawn, gridded, draw, told):
    with pytest.raises(SceneError, match=told):
        draw(drawn, gridded)
