"""Members as users give them."""

import numpy as np
import pandas as pd
import pytest
import xarray

import cotree
from cotree.ensemble.members import check_columns, read_members
from cotree.errors import ParameterError


@pytest.mark.parametrize(
    "given",
    [
        pd.DataFrame({"L": [0.9, 1.1], "k": [40, 50]}),
        {"L": [0.9, 1.1], "k": np.array([40, 50], dtype=np.int32)},
        [{"L": 0.9, "k": 40}, {"k": 50, "L": 1.1}],
        np.array([(0.9, 40), (1.1, 50)], dtype=[("L", float), ("k", int)]),
    ],
    ids=["table", "arrays", "list", "records"],
)
def test_every_form_gives_the_same_members(given):
    members = read_members(given)
    assert members.columns == ("L", "k")
    np.testing.assert_array_equal(members.rows, [[0.9, 40.0], [1.1, 50.0]])
    assert list(members.dimensions) == ["member"]


def test_a_number_counts_for_all_members_and_a_grid_is_a_product():
    assert read_members({"L": [0.9, 1.1], "k": 40}).rows.tolist() == [[0.9, 40.0], [1.1, 40.0]]
    members = read_members(cotree.grid({"j1.s": [0.4, 0.5]}, k=[40, 50, 60]))
    assert members.shape == (2, 3)
    assert members.rows[1].tolist() == [0.4, 50.0]
    assert members.described(4) == "the member j1.s = 0.5, k = 50"


def test_the_index_of_a_table_labels_its_members():
    table = pd.DataFrame({"L": [0.9, 1.1]}, index=["short", "long"])
    assert read_members(table).described(1) == "member long (L = 1.1)"


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (None, "members are missing"),
        (3, "cannot be a int"),
        (xarray.Dataset({"L": ("member", [1.0])}), "cannot be a Dataset"),
        ("L", "cannot be a str"),
        ({}, "no columns"),
        ([], "members are empty"),
        (pd.DataFrame(), "no columns"),
        ({"L": []}, "members are empty"),
        (pd.DataFrame({"L": []}), "members are empty"),
        ({"L": [1.0, 2.0], "k": [1.0]}, "'L' has 2 values, 'k' has 1"),
        ({"L": np.ones((3, 2))}, r"column 'L' of members has shape \(3, 2\)"),
        ({"L": [[1.0], [1.0, 2.0]]}, "'L' of members is not a sequence of numbers"),
        ({"L": [1.0, np.nan]}, "'L' of members, row 1, is nan"),
        ({"L": [1.0, np.inf]}, "'L' of members, row 1, is inf"),
        ({"L": np.ma.array([1.0, 2.0], mask=[False, True])}, "row 1, is nan"),
        ({"L": ["1", "2"]}, "row 0, is '1': give a number"),
        ({"L": [1.0, None]}, "row 1, is 'None': give a number"),
        ({"L": [True, False]}, "row 0, is 'True': give a number"),
        ({"L": [1.0, 2j]}, "row 0, is"),
        ({"L": pd.array([1, None], dtype="Int64")}, "row 1, is nan"),
        ({"L": (v for v in (1.0, 2.0))}, "'L' of members is '<generator"),
        ({3: [1.0]}, "column 3: name it"),
        (pd.DataFrame([[1.0, 2.0]], columns=["L", "L"]), "two columns 'L'"),
        (pd.DataFrame({"L": [1.0, 2.0]}, index=["a", "a"]), "index of members has a 2 times"),
        (
            pd.DataFrame({"L": [1.0]}, index=pd.MultiIndex.from_tuples([("a", 1)])),
            "several levels",
        ),
        ([{"L": 1.0}, {"k": 1.0}], "member 0 has no value of 'k'"),
        ([{"L": 1.0}, 2.0], "member 1 is 2.0"),
        (np.ones((3, 2)), "cannot be a ndarray"),
    ],
)
def test_what_is_no_member_is_refused_by_column_and_row(given, told):
    with pytest.raises(ParameterError, match=told):
        read_members(given)


@pytest.mark.parametrize(
    ("axes", "told"),
    [
        ({}, "has no axes"),
        ({"L": []}, "axis 'L' of the grid is empty"),
        ({"L": [1.0, 1.0]}, "axis 'L' of the grid has 1 twice"),
        ({"L": [1.0, np.nan]}, "axis 'L' of the grid, row 1, is nan"),
        ({"L": np.arange(1e5), "k": np.arange(1e5)}, "has 10000000000 members"),
        ([1.0], "takes a mapping"),
        ({1: [1.0]}, "axis 1: give its name"),
    ],
)
def test_what_is_no_grid_is_refused(axes, told):
    with pytest.raises(ParameterError, match=told):
        cotree.grid(axes)
    with pytest.raises(ParameterError, match="two axes 'L'"):
        cotree.grid({"L": [1.0]}, L=[2.0])


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("LL", "has no tunable parameter or state of this name; did you mean 'L'"),
        ("j1.x", "did you mean 'j1.s'"),
        ("k", r"'k' is a column of members and in parameters=: give it once"),
        ("j1.s", r"'j1.s' is a column of members and in initial=: give it once"),
    ],
)
def test_columns_that_the_model_does_not_have_are_refused(name, told):
    model = cotree.load("slider-pendulum").compile()
    with pytest.raises(ParameterError, match=told):
        check_columns(["L", name], model.kernels, {"k": 50.0}, {"j1.s": 0.1})


def test_derived_parameters_and_inputs_are_no_columns():
    scene = cotree.Scene("cart")
    scene.parameter("m", 2.0)
    scene.parameter("weight", "9.81*m")
    scene.input("push", 0.0, unit="N")
    scene.edge("rail", "prismatic", "ground", "A", axis=[1, 0, 0], force="push - 0.1*weight")
    scene.edge("cart", "rigid_body", "ground", "A", mass="m")
    model = scene.compile()
    with pytest.raises(ParameterError, match=r"'weight' is derived, weight = 9\.81"):
        model.ensemble(members={"weight": [1.0]})
    with pytest.raises(ParameterError, match="an input: give inputs="):
        model.ensemble(members={"push": [1.0]})
    # s = F t^2 / (2 m), with the gain as a column; tolerances of 1e-8.
    runs = model.ensemble((0, 2), {"f": [1.0, 3.0]}, t_eval=2, inputs={"push": "f + 0.1*weight"})
    np.testing.assert_allclose(runs["rail.s"][:, -1], [1.0, 3.0], rtol=1e-7)
