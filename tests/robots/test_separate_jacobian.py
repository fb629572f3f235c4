"""Long Jacobians: they are compiled when they are first needed, with the same bits."""

from __future__ import annotations

import os
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from robot_files import read, stored_file

from cotree.build import BuildOptions, cache_directory
from cotree.model.further import whole_files
from cotree.model.loading import load_model

pytestmark = pytest.mark.compiler


@pytest.fixture
def model(monkeypatch, tmp_path):
    monkeypatch.setenv("COTREE_CACHE_DIR", str(tmp_path / "cache"))
    return read(stored_file("panda")).compile(tunable=())


def n_libraries():
    return len(list(cache_directory().glob("*.so")))


def test_a_jacobian_is_compiled_when_it_is_needed(model):
    assert "int panda_jacobian(" not in model.kernels.text.files["panda.c"]
    assert "int panda_jacobian(" in model.kernels.source
    y = 0.1 * np.arange(1.0, 1 + len(model.states))
    assert n_libraries() == 1
    rates = model.rhs(0.0, y)
    model.rhs(0.0, np.array([y, y]).T)
    n = n_libraries()
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: model.jacobian(0.0, y), range(4)))
    assert n_libraries() == n + 1
    text = replace(model.kernels.text, files=whole_files(model.kernels.text), is_divided=False)
    whole = load_model(text, BuildOptions())
    assert n_libraries() == n + 2
    assert np.array_equal(whole.rhs(0.0, y), rates)
    for own in found:
        assert np.array_equal(own, whole.jacobian(0.0, y))
    again = pickle.loads(pickle.dumps(model))
    assert np.array_equal(again.jacobian(0.0, y), found[0])


def test_explicit_methods_need_no_jacobian(model):
    n = n_libraries()
    one = model.simulate((0.0, 0.01), method="dopri5")
    engine = n_libraries() - n
    other = model.simulate((0.0, 0.01), method="rodas5")
    assert n_libraries() > n + engine + 1  # the Jacobian, the engine and the Newton matrices
    assert np.allclose(one.y[:, -1], other.y[:, -1], rtol=1e-4, atol=1e-6)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes cannot fork")
def test_a_forked_process_compiles_the_jacobian(model):
    y = 0.1 * np.arange(1.0, 1 + len(model.states))
    model.rhs(0.0, y)
    read_end, write_end = os.pipe()
    if (child := os.fork()) == 0:
        try:
            os.write(write_end, model.jacobian(0.0, y).tobytes()[:4096])
        finally:
            os._exit(0)
    os.close(write_end)
    with os.fdopen(read_end, "rb") as pipe:
        sent = pipe.read()
    os.waitpid(child, 0)
    assert sent
    assert sent == model.jacobian(0.0, y).tobytes()[: len(sent)]
