"""Every public call on every kind of model: a result of the right kind, or a documented refusal."""

from __future__ import annotations

import pickle
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import cotree
from cotree.cli import main

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = [pytest.mark.compiler, pytest.mark.filterwarnings("ignore")]


def modes() -> cotree.Scene:
    """Build a hinge whose torque has a mode that an event sets."""
    scene = cotree.Scene("modes")
    scene.mode("level", 0)
    scene.event("passed", "h.theta - 2", set={"level": "1"})
    law = "u + T + level - 0.1*h.theta_dot - 3*h.theta"
    hinge = {"axis": [0, 0, 1], "torque": law, "initial": {"theta": 0.5}}
    scene.revolute("h", "ground", "A", **hinge)
    scene.rigid_body("b", "ground", "A", mass=1.0, inertia=0.1)
    scene.output("y", "h.theta")
    return scene


def friction() -> cotree.Scene:
    """Build an oscillator with dry friction, whose modes are the scene's own."""
    scene = cotree.Scene("friction")
    scene.edge("m", "rotational_inertia", "ground", "A", inertia="T", initial={"w": 1.0})
    scene.edge("f", "rotational_dry_friction", "ground", "A", torque=0.3)
    scene.edge("k", "rotational_spring", "ground", "A", stiffness=2.0)
    scene.edge("d", "torque_source", "ground", "A", torque="u")
    scene.output("y", "m.w")
    return scene


def jump() -> cotree.Scene:
    """Build a capacitor whose current jumps with its voltage."""
    scene = cotree.Scene("jump")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 0.2})
    scene.edge("R", "resistor", "a", "ground", resistance="T")
    scene.edge("I", "current_source", "ground", "a", current="u + where(C.v > 0.4, 0.5, 1)")
    scene.output("y", "C.v")
    return scene


def events() -> cotree.Scene:
    """Build a saw-tooth: an event sets a state."""
    scene = cotree.Scene("events")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("R", "resistor", "a", "ground", resistance=5.0)
    scene.edge("I", "current_source", "ground", "a", current="1 + u")
    scene.event("reset", "C.v - 0.7*T", direction=1, set={"C.v": "0.1*T"})
    scene.output("y", "C.v")
    return scene


def algebraic() -> cotree.Scene:
    """Build a rectifier, whose inner voltage is an algebraic unknown."""
    scene = cotree.Scene("algebraic")
    scene.edge("V", "voltage_source", "a", "ground", voltage="5 + u")
    scene.edge("R", "resistor", "a", "b", resistance="100*T")
    scene.edge("D", "diode", "b", "c", saturation_current=1e-12)
    scene.edge("R2", "resistor", "c", "ground", resistance=100.0)
    scene.edge("R3", "resistor", "c", "d", resistance=100.0)
    scene.edge("C", "capacitor", "d", "ground", capacitance=1e-3)
    scene.output("y", "C.v")
    return scene


def constraints() -> cotree.Scene:
    """Build a pendulum in Cartesian coordinates."""
    scene = cotree.Scene("constraints", gravity=[0, -9.81, 0])
    scene.edge("px", "prismatic", "ground", "X", axis=[1, 0, 0], force="u", initial={"s": "0.6*T"})
    scene.edge("py", "prismatic", "X", "P", axis=[0, 1, 0], initial={"s": "-0.8*T"})
    scene.edge("m", "rigid_body", "ground", "P", mass=1.0)
    scene.edge("d", "distance", "ground", "P", length="T")
    scene.output("y", "px.s")
    return scene


def quaternion() -> cotree.Scene:
    """Build a free body: more coordinates than speeds, and a norm that is held."""
    scene = cotree.Scene("quaternion")
    scene.edge("f", "free", "ground", "A", initial={"w1": 0.2, "w2": 0.5})
    scene.edge("b", "rigid_body", "ground", "A", mass=1.0, inertia=["T", 2.0, 3.0])
    scene.edge("t", "torque", "ground", "A", torque=["u", 0, 0])
    scene.output("y", "f.w1")
    return scene


def stateless() -> cotree.Scene:
    """Build a voltage divider, which has no states."""
    scene = cotree.Scene("stateless")
    scene.edge("V", "voltage_source", "a", "ground", voltage="1 + u")
    scene.edge("R1", "resistor", "a", "b", resistance="T")
    scene.edge("R2", "resistor", "b", "ground", resistance=3.0)
    scene.output("y", "R2.v")
    return scene


def static() -> cotree.Scene:
    """Build a network with algebraic unknowns and no storages."""
    scene = cotree.Scene("static")
    scene.edge("V", "voltage_source", "a", "ground", voltage="5 + u")
    scene.edge("R", "resistor", "a", "b", resistance="100*T")
    scene.edge("D", "diode", "b", "ground", saturation_current=1e-12)
    scene.output("y", "D.v")
    return scene


KINDS = {
    make.__name__: make
    for make in (
        modes,
        friction,
        jump,
        events,
        algebraic,
        constraints,
        quaternion,
        stateless,
        static,
    )
}
TIMES = np.linspace(0.0, 1.0, 6)


class Subject:
    """A scene of one kind and its model, which differ in nothing from run to run."""

    def __init__(self, kind: str) -> None:
        self.scene = KINDS[kind]()
        self.scene.parameter("T", 1.0)
        self.scene.input("u", 0.0)
        self.model = self.scene.compile(["T"])
        self.n = len(self.model.states)

    @property
    def y(self) -> Any:
        return self.model.start().y

    @property
    def many(self) -> Any:
        return np.tile(self.y[:, None], 3)

    def run(self, **settings: Any) -> cotree.Result:
        return self.model.simulate((0, 1), TIMES, **settings)

    def members(self, **settings: Any) -> Any:
        return self.model.ensemble((0, 1), {"T": [1.0, 1.1, 1.2]}, t_eval=TIMES, **settings)

    def fitted(self, **settings: Any) -> Any:
        data = cotree.Experiment({"t": TIMES[1:], "y": 1.05 * self.run()["y"][-5:]}, noise=0.1)
        return cotree.fit(self.model, data, {"T": (0.8, 1.3)}, starts=2, **settings)


_made: dict[str, Subject] = {}


def made(kind: str) -> Subject:
    """Return the subject of a kind; compiled once."""
    if kind not in _made:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _made[kind] = Subject(kind)
    return _made[kind]


def shapes(*arrays: Any) -> tuple[tuple[int, ...], ...]:
    """Return the shapes of arrays, whose values must be finite."""
    for array in arrays:
        assert np.all(np.isfinite(array))
    return tuple(np.shape(array) for array in arrays)


def points(s: Subject) -> list[Callable[[], Any]]:
    m = s.model
    return [
        lambda: m.trim().settings["initial"],
        lambda: m.trim(["u"]).summary(),
        lambda: m.trim(["T"]).u,
        lambda: repr(m.trim(["T"], outputs={"y": 0.55})),
        lambda: m.trim(["u"], rates=dict.fromkeys(m.states)).is_unique,
        lambda: [m.trim().sensitivity(name, "T") for name in m.trim().unknowns],
        lambda: m.trim().linearize(reduced=True, sensitivities=["T", "u"]).A,
        lambda: s.run(**m.trim().settings).y,
        lambda: m.linearize().eigenvalues,
        lambda: m.linearize(reduced=True).A,
        lambda: m.linearize(reduced=True, sensitivities=["T", "u"]).summary(),
        lambda: m.linearize(sensitivities=list(m.states)).B,
        lambda: m.linearize(sensitivities=["T"], total=True).sensitivity("T").A,
        lambda: m.linearize(sensitivities=["T"]).eigenvalue_sensitivity("T"),
        lambda: (repr(m.linearize()), m.linearize()._repr_html_()),
        lambda: m.linearize().to_scipy(),
    ]


def kernels(s: Subject) -> list[Callable[[], Any]]:
    m, n, k = s.model, s.n, 1
    at, several = np.zeros((n, k)), np.zeros((n, k, 3))
    one = [
        (lambda: m.rhs(0.0, s.y), (n,)),
        (lambda: m.jacobian(0.0, s.y), (n, n)),
        (lambda: m.kernels.jacobian_sparse(0.0, s.y).toarray(), (n, n)),
        (lambda: m.sensitivity_rhs(0.0, s.y, at), (n, k)),
        (lambda: m.output_values(0.0, s.y), (1,)),
        (lambda: m.output_sensitivity(0.0, s.y, at), (1, k)),
        (lambda: m.kernels.constraint_values(0.0, s.y), (len(m.kernels.constraints),)),
        (lambda: m.rhs(np.zeros(3), s.many), (n, 3)),
        (lambda: m.jacobian(0.0, s.many), (n, n, 3)),
        (lambda: m.sensitivity_rhs(0.0, s.many, several), (n, k, 3)),
        (lambda: m.output_values(0.0, s.many), (1, 3)),
        (lambda: m.output_sensitivity(0.0, s.many, several), (1, k, 3)),
        (lambda: m.kernels.constraint_values(0.0, s.many), (len(m.kernels.constraints), 3)),
        (lambda: m.kernels.initial(), (n,)),
        (lambda: m.kernels.initial_sensitivity(), (n, k)),
        (lambda: m.kernels.input_values(0.0), (1,)),
        (lambda: m.start(p={"T": 1.1}).s, (n, k)),
    ]

    def checked(call: Callable[[], Any], shape: tuple[int, ...]) -> None:
        assert shapes(call()) == (shape,)

    return [
        *(lambda call=call, shape=shape: checked(call, shape) for call, shape in one),
        lambda: (
            m.summary(),
            repr(m),
            m._repr_html_(),
            m.kernels.source,
            m.kernels.digest,
            m.operations,
        ),
        lambda: (
            m.kernels.derived(),
            m.kernels.has_constant_start,
            m.kernels.unreached,
            m.kernels.constraints,
            m.kernels.junctions,
            m.kernels.slopes,
        ),
        lambda: (
            m.kernels.structure.jacobian_colouring,
            m.kernels.structure.jacobian_pattern,
            m.kernels.structure.jacobian_sparsity,
        ),
        lambda: pickle.loads(pickle.dumps(m)).rhs(0.0, s.y),
        lambda: m.as_casadi(0.0),
        lambda: s.scene.with_inputs({"u": "0.01*T*t"}).compile(["T"]).simulate((0, 0.1)),
        lambda: (s.scene.equations(["T"]), s.scene.graph(), s.scene.lint(), s.scene.summary()),
    ]


METHODS = ("dopri5", "rkf45", "dop853", "rodas4", "rodas5", "cvode", "ida", "auto")
OF_SCIPY = ("RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA")


def runs(s: Subject) -> list[Callable[[], Any]]:
    def good(**settings: Any) -> None:
        run = s.run(**settings)
        assert run.success, run.message
        shapes(run.y, run["y"])

    r = s.run
    return [
        *(lambda name=name: good(method=name) for name in (*METHODS, *OF_SCIPY)),
        lambda: good(sensitivities=False),
        lambda: good(inputs={"u": "0.01*sin(t)"}),
        lambda: good(inputs={"u": lambda t: 0.01 * t}),
        lambda: good(inputs={"u": ([0, 1], [0.01, 0.02])}),
        lambda: s.model.simulate((0, 1), parameters={"T": 1.1}).y,
        lambda: (r().summary(), repr(r()), r()._repr_html_(), r().columns, r().message),
        lambda: (r().drift, r().units, r().unit("y"), r().redundant, r().times),
        lambda: shapes(r().sensitivity("y", "T")),
        lambda: [r().event_sensitivity(name, "T") for name in r().events],
        lambda: r().smooth().y,
        lambda: r().to_dataframe(),
        lambda: r().plot(),
        lambda: r().plot(["y"]),
    ]


def ensembles(s: Subject) -> list[Callable[[], Any]]:
    return [
        lambda: shapes(s.members()["y"]),
        lambda: shapes(s.members(method="rodas5")["y"]),
        lambda: shapes(s.members(method="BDF")["y"]),
        lambda: s.members(inputs={"u": "0.01*t"}),
        lambda: cotree.bands(s.members(), "y"),
        lambda: cotree.curves(s.members(), "y"),
        lambda: cotree.heat_map(
            s.model.ensemble((0, 1), cotree.grid(T=[1.0, 1.1], c=[0, 1]), inputs={"u": "0.01*c"}),
            "y",
        ),
    ]


def searches(s: Subject) -> list[Callable[[], Any]]:
    def fitted() -> None:
        found = s.fitted()
        assert np.isfinite(found.optimality)
        _ = (str(found), found._repr_html_(), found.to_json(), found.starts_table())
        _ = (found.plot(), found.profile("T"), found.intervals(), found.predictions)
        found.next_measurements(cotree.Candidates("y", TIMES[1:]))

    def designed(goal: str, **settings: Any) -> None:
        box = {"T": (0.8, 1.3)}
        found = cotree.optimise(s.model, goal, box, t_span=(0, 1), **settings)
        assert np.isfinite(found.optimality)
        assert found.violation >= 0.0
        _ = (found.summary(), repr(found), found._repr_html_())

    return [
        fitted,
        lambda: designed("(y - 0.3)**2 + T"),
        lambda: designed("integral(y**2) + T", subject_to="T >= 0.9", method="trust-constr"),
        lambda: designed("maximum(y) + T", max_iterations=3),
        lambda: cotree.bench(s.model, methods=["dopri5", "rodas5"], tolerances=[1e-4], repeats=1),
    ]


def files(s: Subject, folder: Path) -> list[Callable[[], Any]]:
    m = s.model
    return [
        lambda: m.write(folder / "explicit"),
        lambda: m.write(folder / "implicit", "rodas5"),
        lambda: m.write(folder / "fixed", "rk4", 0.01),
        lambda: m.write(folder / "single", "euler", 0.01, real="float", cpp=True),
        lambda: m.export_fmu(folder / "three.fmu"),
        lambda: m.export_fmu(folder / "two.fmu", 2),
        lambda: s.run().to_csv(folder / "run.csv"),
        lambda: cotree.load(s.scene.save(folder / "scene.toml") or folder / "scene.toml"),
    ]


# What is refused, and a word of the reason; whatever else raises is a fault.
REFUSED = {
    "points": {
        "modes": (),
        "friction": ("no equilibrium", "is 0.5 at this point"),
        "jump": ("switch at every attempt",),
        "events": ("no equilibrium",),
        "algebraic": (),
        "constraints": ("no equilibrium", "multiple eigenvalue"),
        "quaternion": ("no equilibrium", "by quaternions", "multiple eigenvalue"),
        "stateless": (),
        "static": (),
    },
    "kernels": dict.fromkeys(("algebraic", "static", "constraints", "quaternion"), ("as_casadi",)),
    "runs": {
        **dict.fromkeys(("modes", "events", "jump"), ("cannot take events",)),
        "algebraic": ("cannot take algebraic unknowns",),
        **dict.fromkeys(("constraints", "quaternion"), ("cannot take constraints",)),
        "friction": ("cannot take events", "affects when an event occurs"),
    },
    "ensembles": {
        **dict.fromkeys(("modes", "events", "jump", "friction"), ("cannot take events",)),
        "algebraic": ("cannot take algebraic unknowns",),
        **dict.fromkeys(("constraints", "quaternion"), ("cannot take constraints",)),
    },
    "searches": {
        "modes": (),
        "friction": (),
        "jump": (),
        "events": ("next to an event",),
        "stateless": ("nothing to integrate",),
        "static": ("nothing to integrate",),
    },
    "files": dict.fromkeys(
        ("modes", "friction", "jump", "events", "algebraic", "static", "constraints", "quaternion"),
        ("rk4", "euler"),
    ),
}


def check(group: str, kind: str, calls: list[Callable[[], Any]]) -> None:
    """Perform all calls of a group: each returns, or raises an expected error of this package."""
    expected = REFUSED[group].get(kind, ())
    for place, call in enumerate(calls):
        try:
            call()
        except Exception as error:
            is_expected = any(words in str(error) for words in expected)
            if not (isinstance(error, cotree.Error) and is_expected):
                raise AssertionError(f"call {place} of {group} on {kind}: {error!r}") from error


@pytest.mark.parametrize("group", ["points", "kernels", "runs"])
@pytest.mark.parametrize("kind", KINDS)
def test_calls_return_or_are_refused(kind, group):
    calls = {"points": points, "kernels": kernels, "runs": runs}[group]
    check(group, kind, calls(made(kind)))


@pytest.mark.slow
@pytest.mark.parametrize("group", ["ensembles", "searches"])
@pytest.mark.parametrize("kind", KINDS)
def test_many_runs_return_or_are_refused(kind, group):
    check(group, kind, {"ensembles": ensembles, "searches": searches}[group](made(kind)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_files_are_written_or_refused(kind, tmp_path):
    check("files", kind, files(made(kind), tmp_path))


COMMANDS = (
    ("run", "--t-end", "0.5", "-s", "T"),
    ("run", "--t-end", "0.5", "--method", "BDF"),
    ("sweep", "--grid", "T=1,1.1", "--t-end", "0.5"),
    ("optimise", "--minimise", "y**2 + T", "--over", "T=0.8:1.3", "--t-end", "0.5"),
    ("generate", "--output", "PLACE"),
    ("export", "--output", "PLACE.fmu"),
    ("equations", "-s", "T"),
    ("graph",),
    ("lint",),
    ("check", "--t-end", "0.5"),
    ("bench", "--t-end", "0.1", "--budget", "0.5"),
    ("save", "--output", "PLACE.toml"),
)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_commands_print_or_complain_in_a_sentence(kind, tmp_path, capsys):
    path = tmp_path / "scene.toml"
    made(kind).scene.save(path)
    for command, *options in COMMANDS:
        placed = [option.replace("PLACE", str(tmp_path / "made")) for option in options]
        code = main([command, str(path), *placed])
        printed = capsys.readouterr()
        assert "Traceback" not in printed.err
        # What is refused is one sentence; options that are wrong would print the usage.
        assert code == 0 or "cotree: " in printed.err or printed.out.strip(), (command, kind)
        assert "Usage" not in printed.err
