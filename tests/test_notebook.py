"""A notebook shows each object as people want it: executed by Jupyter's own client and kernel."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

SRC = Path(__file__).parents[1] / "src"

CELLS = {
    "scene": 'import cotree\nscene = cotree.load("slider-pendulum")\nscene',
    "parameters": "scene.parameters",
    "graph": "scene.graph()",
    "equations": 'scene.equations(["L"])',
    "model": 'model = scene.compile(["L"])\nmodel',
    "result": "result = model.simulate((0, 4), rtol=1e-4, atol=1e-6)\nresult",
    "plot": 'result.plot(["j1.s"])',  # pyplot has not been imported by anybody
    "drawn": "figure = scene.graph().draw()",
    "again": "figure",
    "show": 'import matplotlib.pyplot as plt\nresult.plot("h2.theta")\nplt.show()',
    "linear": "model.linearize()",
    "operations": "model.operations",
    "error": 'scene.edge("x", "revolut", "A", "B")',
}


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory):
    """Outputs of each cell of one notebook."""
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    cells = [nbformat.v4.new_code_cell(source) for source in CELLS.values()]
    notebook = nbformat.v4.new_notebook(cells=cells)
    folder = tmp_path_factory.mktemp("notebook")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(SRC), os.environ.get("PYTHONPATH", "")]))
        patch.delenv("MPLBACKEND", raising=False)  # a kernel chooses its own
        for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):
            patch.setenv(name, str(folder))
        run = client.NotebookClient(
            notebook, allow_errors=True, timeout=120, resources={"metadata": {"path": str(folder)}}
        )
        run.execute()
    return dict(zip(CELLS, (cell.outputs for cell in notebook.cells), strict=True))


def only(outputs, mime):
    """The one output of a cell in a language."""
    found = [row["data"][mime] for row in outputs if mime in row.get("data", {})]
    assert len(found) == 1, outputs
    return found[0]


@pytest.mark.slow
@pytest.mark.compiler
def test_a_notebook_shows_each_object(outputs):
    for name, words in {
        "scene": ["slider-pendulum", "revolute", "mass of the rod", "C.x"],
        "parameters": ["N m s/rad", "damping of the hinge"],
        "model": ["j1.s [m]", "rodas5", "sensitivities", "mass of the block"],
        "result": ["∂ j1.s / ∂ L", "largest", "dop853"],
        "linear": ["eigenvalues of A", "j1.s_dot", "rod_x"],
        "operations": ["augmented_rhs", "prepared"],
    }.items():
        text = only(outputs[name], "text/html")
        assert all(word in text for word in words), (name, text)
        assert len(text) < 12_000, name
    assert only(outputs["graph"], "image/svg+xml").startswith("<svg")
    latex = only(outputs["equations"], "text/latex")
    assert latex.startswith(r"$$\begin{aligned}")
    assert r"\ddot{s}" in latex


@pytest.mark.slow
@pytest.mark.compiler
def test_a_figure_is_shown_once(outputs):
    """Whether or not it is the value of its cell, and whoever imported pyplot first."""
    for name in ("plot", "drawn", "again", "show"):
        only(outputs[name], "image/png")


@pytest.mark.slow
@pytest.mark.compiler
def test_an_error_shows_the_cell_and_the_sentence(outputs):
    (row,) = outputs["error"]
    shown = "\n".join(row["traceback"])
    assert 'scene.edge("x", "revolut", "A", "B")' in shown
    assert "unknown type 'revolut'; did you mean 'revolute'?" in shown
    assert "description.py" not in shown
    assert len(shown.splitlines()) <= 4
