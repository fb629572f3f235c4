"""Published models run as by another route: libsbml's trees in Python, SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from published import shared_folder

import cotree

pytest.importorskip("libsbml")

from sbml_reference import Reference

from cotree.readers.sbml.scene import read_sbml_model

FOLDER = shared_folder("petab")
ENDS = {"Fujita_SciSignal2010": 1000.0, "Boehm_JProteomeRes2014": 60.0, "Bachmann_MSB2011": 3.0}
#: Small errors of this model grow by thousands; LSODA's are larger than its tolerance says, and
#: SciPy's Radau agrees with this method to 1e-8.
METHODS = {"Crauste_CellSystems2017": "DOP853"}
MODELS = sorted(FOLDER.glob("benchmark/*/model*.xml"))
CASES = sorted(FOLDER.glob("test_suite/*/*.xml"))


def _compare(path, t_end, changed):
    text = path.read_text()
    model = read_sbml_model(path, cotree.Scene)
    for id, value in changed.items():
        model.scene.set(model.symbols[id].initial, value)
    times, method = np.linspace(0.0, t_end, 5), METHODS.get(path.parent.name, "LSODA")
    result = model.scene.compile([]).simulate((0.0, t_end), times, rtol=1e-9, atol=1e-12)
    for id, values in Reference(text, changed).run(times, method).items():
        # A thousand times the tolerances of both, which bound single steps; what is small beside
        # its own largest value is as wrong as that.
        floor = 1e-6 * np.abs(values).max()
        found = result[model.symbols[id].name]
        np.testing.assert_allclose(found, values, rtol=1e-6, atol=max(floor, 1e-9), err_msg=id)


@pytest.mark.slow
@pytest.mark.parametrize("path", MODELS, ids=[path.parent.name for path in MODELS])
def test_benchmark_models(path):
    _compare(path, ENDS.get(path.parent.name, 10.0), {})


def test_models_of_the_test_suite():
    assert len(CASES) >= 20
    seen = set()
    for path in CASES:
        text = path.read_text()
        # Most cases have one model; the others differ in their measurements.
        if text not in seen:
            seen.add(text)
            known = read_sbml_model(path, cotree.Scene).symbols
            rates = {k: v for k, v in (("k1", 0.8), ("k2", 0.6), ("a0", 1.0)) if k in known}
            _compare(path, 5.0, rates)
