"""Import of measured data, and error messages for invalid data."""

from __future__ import annotations

import numpy as np
import pytest

import cotree


def write(folder, text, name="run1.csv"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        "time,v\n0,1.5\n1,2.5\n",
        "# made by a logger\nTime;v;\n0;1,5;\n\n1;2,5;\n",
        "\ufefft\tv [V]\n0\t1.5\n1\t2.5\n",
        'time (ms), "v [mV]"\n0, 1500\n1000, 2500\n,\n',
    ],
)
def test_csv_files_with_different_separators_and_headers_are_read(tmp_path, text):
    table = cotree.Experiment(write(tmp_path, text)).table
    assert table.t.tolist() == [0.0, 1.0]
    column = table.columns["v"]
    scale = 1e-3 if column.unit == "mV" else 1.0
    assert (scale * column.values).tolist() == [1.5, 2.5]


def test_all_sources_represent_missing_values_alike(tmp_path):
    pd = pytest.importorskip("pandas")
    path = write(tmp_path, "t,a,b\n0,1,\n1,NaN,4\n2,3,n/a\n")
    frame = pd.DataFrame({"t": [0, 1, 2], "a": [1, None, 3], "b": [np.nan, 4, np.nan]})
    for data in (path, frame, frame.set_index("t"), dict(frame)):
        table = cotree.Experiment(data).table
        assert np.array_equal(table.columns["a"].values, [1, np.nan, 3], equal_nan=True)
        assert np.array_equal(table.columns["b"].values, [np.nan, 4, np.nan], equal_nan=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "run1.csv is empty: it needs a line of names"),
        ("t,v\n", "run1.csv has no numbers below its first line"),
        ("0,1\n1,2\n", "run1.csv begins with numbers: its first line must name the columns"),
        ("v,w\n1,2\n", "run1.csv has no column 't' or 'time', only 'v', 'w': name the time column"),
        ("t,v\n0,1\n1,abc\n", "run1.csv, line 3, column 'v': 'abc' is not a number"),
        ("t,v\n0,1\n1,inf\n", "run1.csv, line 3, column 'v': inf is not finite"),
        ("t,v\n0,1\n1,2,3\n", "run1.csv, line 3 has 3 fields, but its first line names 2 columns"),
        ("t,v,v\n0,1,1\n", "run1.csv has two columns 'v'"),
        ("t,v\n0,1\n2,1\n1,1\n", "run1.csv, line 4: the time 1 s is before 2 s of line 3: sort"),
        ("t,v\n0,1\n0,1\n", "run1.csv: the time 0 s occurs in line 2 and in line 3: give repeated"),
        ("t,v\n0,1\n,1\n", "run1.csv, line 3: there is no time in column 't'"),
        ("t,v\n-1,1\n0,1\n", "run1.csv, line 2: the time -1 s is before the start of the run at 0"),
        ("t [V],v\n0,1\n", "column 't' of run1.csv is given in 'V', but is in 's'"),
    ],
)
def test_errors_in_files_are_reported_with_the_file_name(tmp_path, text, message):
    with pytest.raises(cotree.ModelError) as caught:
        cotree.Experiment(write(tmp_path, text))
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("absent.csv", "'absent.csv' is not a file"),
        (5, "the data is 5: give a DataFrame, a mapping of columns, or the path"),
        ({}, "the data is empty"),
        ({"t": [0, 1], "v": [1]}, "column 'v' of the data has 1 values, but 't' has 2"),
        ({"t": [0, 1], "v": [[1], [2]]}, "column 'v' of the data has shape (2, 1)"),
        ({"t": [0, 1], "v": [1, "x"]}, "the data, row 1, column 'v': 'x' is not a number"),
        ({"t": [0], 3: [1]}, "the data has the column 3: names must be strings"),
        ({"t": [0], "v": [1j]}, "the data, column 'v' holds complex numbers"),
        ({"t": np.array(["2020-01-01"], "M8[s]"), "v": [1]}, "the data, column 't' holds dates"),
    ],
)
def test_invalid_data_are_refused(data, message):
    with pytest.raises(cotree.ModelError) as caught:
        cotree.Experiment(data)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"observables": {"w": "C.v"}}, "the data has no column 'w'; known: v"),
        ({"observables": {"v": 3}}, "column 'v' of the data measures 3"),
        ({"noise": {"w": 0.1}}, "noise: the data has no column 'w'"),
        ({"units": {"w": "V"}}, "units: the data has no column 'w'"),
        ({"transform": "log2"}, "transform of the data is 'log2'"),
        ({"time": "zeit"}, "the data has no column 'zeit'"),
        ({"initial": {"C.v": None}}, "'C.v' in initial of the data"),
        ({"t_start": 0.5}, "the data, row 0: the time 0 s is before the start of the run at 0.5"),
    ],
)
def test_invalid_options_are_refused(options, message):
    with pytest.raises(cotree.ModelError) as caught:
        cotree.Experiment({"t": [0, 1], "v": [1, 2]}, **options)
    assert str(caught.value).startswith(message)
