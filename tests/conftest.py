"""Options, markers and shared fixtures of all tests."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import gc
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from cotree import Model, Scene
    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Equations, Guard
    from cotree.program.program import Program

# Workers share the cores. Where each runs small linear algebra on all of them, threads wait for
# each other, and a decomposition takes ten times as long. Workers inherit this before they load
# NumPy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A busy machine is no failure of a property.
settings.register_profile("cotree", deadline=None)
settings.load_profile("cotree")

SCENES = ("slider-pendulum", "spring-mass-damper")

_ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def _no_figures_left() -> Iterator[None]:
    """Close what a test drew, where pyplot keeps it: it warns of twenty."""
    yield
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None:
        pyplot.close("all")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run the slow tests too")
    parser.addoption("--campaign", action="store_true", help="run whole campaigns of damage too")
    parser.addoption("--update-golden", action="store_true", help="rewrite the golden files")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--campaign"):
        of_campaign = pytest.mark.skip(reason="a campaign: run with --campaign")
        for item in items:
            if item.get_closest_marker("campaign"):
                item.add_marker(of_campaign)
    _keep_one_with_clang(config, items)
    if config.getoption("--slow") or os.environ.get("CI") == "true":
        return
    skip = pytest.mark.skip(reason="slow: run with --slow")
    for item in (*filter(_is_slow, items), *_beyond_samples(items)):
        item.add_marker(skip)


def _keep_one_with_clang(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Without --campaign run one case with clang of each test of compiled C: most C is shared."""
    if config.getoption("--campaign"):
        return
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        called = getattr(item, "callspec", None)
        is_run = item.path.parent.name == "c" or "runs_clean_under" in item.name
        if is_run and called is not None and called.params.get("compiler") == "clang":
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    # By name, those with sensitivities, which have more C, come behind those without.
    left_out = {
        item
        for found in cases.values()
        for item in sorted(found, key=lambda item: item.nodeid)[:-1]
    }
    config.hook.pytest_deselected(items=list(left_out))
    items[:] = [item for item in items if item not in left_out]


def _is_slow(item: pytest.Item) -> bool:
    return item.get_closest_marker("slow") is not None


def _beyond_samples(items: list[pytest.Item]) -> list[pytest.Item]:
    """List the cases of sampled tests that a quick run leaves out, spread evenly."""
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("sampled") and not _is_slow(item):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    left_out = []
    for found in cases.values():
        found.sort(key=lambda item: item.nodeid)  # whatever order they are run in
        marker = found[0].get_closest_marker("sampled")
        assert marker is not None
        every = -(-len(found) // marker.args[0])
        left_out += [item for i, item in enumerate(found) if i % every]
    return left_out


def pytest_collection_finish() -> None:
    """Exclude from cycle collection the objects of the session, and collect less often."""
    # It takes a fifth of the time otherwise: a scene's equations are some 100,000 objects.
    gc.freeze()
    gc.set_threshold(100_000, 10, 10)


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("compiler"):
        from cotree.build import find_toolchain

        if find_toolchain() is None:
            pytest.skip("no C compiler")


@pytest.fixture(autouse=True, scope="session")
def _session_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the user's cache out of the tests, and the tests out of it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # what one worker compiled serves the others
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COTREE_CACHE_DIR", str(folder / "cache"))
        # Tests change how programs are formed; those of kept programs ask for them.
        patch.setattr("cotree.build.cache.KEEPS", False)
        yield


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Compare a text with a file below generated/, or another folder, byte for byte."""

    def compare(path: str, text: str, folder: str = "generated") -> None:
        file = _ROOT / folder / path
        if request.config.getoption("--update-golden"):
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(text.encode())
            return
        known = file.read_bytes().decode() if file.exists() else ""
        if text != known:
            diff = difflib.unified_diff(
                known.splitlines(keepends=True),
                text.splitlines(keepends=True),
                f"{folder}/{path}",
                "generated now",
            )
            pytest.fail(f"{''.join(diff)}\nIf this is meant: pytest --update-golden", pytrace=False)

    return compare


@functools.cache
def _model(name: str, sensitivities: tuple[str, ...]) -> Model:
    import cotree

    return cotree.load(name).compile(list(sensitivities))


@functools.cache
def _equations(name: str, sensitivities: tuple[str, ...]) -> Equations:
    import cotree
    from cotree.pipeline import formulate

    return formulate(cotree.load(name), sensitivities, None)[1]


@functools.cache
def _lowered(name: str, sensitivities: tuple[str, ...]) -> Program:
    from cotree.program.lower import lower

    return lower(_equations(name, sensitivities))


@functools.cache
def _program(name: str, sensitivities: tuple[str, ...]) -> Program:
    from cotree.program.passes import run_passes

    return run_passes(_lowered(name, sensitivities))[0]


def _wanted(name: str, sensitivities: Sequence[str] | None) -> tuple[str, ...]:
    """Return the sensitivities; None means those to all parameters."""
    import cotree

    return tuple(cotree.load(name).parameters if sensitivities is None else sensitivities)


@pytest.fixture(params=SCENES)
def scene_name(request: pytest.FixtureRequest) -> str:
    """Name each shipped scene in turn."""
    return str(request.param)


@pytest.fixture
def scene(scene_name: str) -> Scene:
    import cotree

    return cotree.load(scene_name)


@pytest.fixture
def model_of() -> Callable[..., Model]:
    """Return the model of a shipped scene, compiled once."""
    return lambda name, sensitivities=None: _model(name, _wanted(name, sensitivities))


@pytest.fixture
def equations_of() -> Callable[..., Equations]:
    """Return the equations of a shipped scene, formed once."""
    return lambda name, sensitivities=None: _equations(name, _wanted(name, sensitivities))


@pytest.fixture
def lowered_of() -> Callable[..., Program]:
    """Return the program of a shipped scene before its passes."""
    return lambda name, sensitivities=None: _lowered(name, _wanted(name, sensitivities))


@pytest.fixture
def program_of() -> Callable[..., Program]:
    """Return the program of a shipped scene after its passes."""
    return lambda name, sensitivities=None: _program(name, _wanted(name, sensitivities))


@pytest.fixture
def made_up() -> Callable[..., Program]:
    """Build a program by hand: an arena, and the results of some kernels."""
    from cotree.equations import Quantity
    from cotree.program.kernels import KERNELS
    from cotree.program.layout import Layout
    from cotree.program.program import Kernel, Program

    def make(
        dag: Dag,
        n_states: int = 1,
        n_parameters: int = 1,
        guards: tuple[Guard, ...] = (),
        text: str = "",
        **results: Sequence[Node],
    ) -> Program:
        def rows(letter: str, n: int) -> tuple[Quantity, ...]:
            return tuple(Quantity(f"{letter}{i}", text, text) for i in range(n))

        nothing: dict[str, Any] = {row.name: () for row in dataclasses.fields(Layout)}
        given = {
            "name": "made-up",
            "states": rows("x", n_states),
            "parameters": rows("p", n_parameters),
            "outputs": rows("y", len(results.get("outputs", ()))),
            "parameter_values": (1.0,) * n_parameters,
            "n_pieces": 0,
            "column_starts": (0,) * (n_states + 1),
            "sensitivity_starts": (0,),
        }
        layout = Layout(**{**nothing, **given})
        kernels = {
            name: Kernel(row, tuple(results.get(name, ())), {}) for name, row in KERNELS.items()
        }
        return Program(dag, layout, kernels, guards)

    return make
