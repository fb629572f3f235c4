"""Random sequences of legal and illegal FMI calls against the exported C, under sanitizers.

``fmi_calls.c`` holds the rules of the standard and makes the calls. Here it is compiled with the
sources of a unit and with what it has to know of it, which comes from the model description.
"""

from __future__ import annotations

import shutil
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import pytest
from c_programs import SANITIZE, compile_once, need, run

import cotree

fmpy = pytest.importorskip("fmpy")

FOLDER = Path(__file__).parent
HEADERS = Path(fmpy.__file__).parent / "c-code"

#: Scenes, with whether small changes of parameters may leave no start, or one without derivatives,
#: and how long steps of explicit Euler may be, as a share of what the driver takes by default.
SCENES = {
    "bouncing-ball": (False, 1.0),  # events
    "motor-linkage": (True, 0.1),  # constraints
    "cart-pole": (False, 1.0),  # inputs
    "robot-arm": (False, 0.1),  # inputs, and events of its controller's limits
    "bridge-rectifier": (False, 0.01),  # algebraic unknowns
}


class Facts:
    """Extract the data of the driver from a model description."""

    def __init__(self, text: str, version: int) -> None:
        root = ET.fromstring(text)
        self.version = version
        self.token = root.attrib["instantiationToken" if version == 3 else "guid"]
        self.t_end = float(root.find("DefaultExperiment").attrib["stopTime"])
        rows = list(root.find("ModelVariables"))
        self.variables = []
        for row in rows:
            own = dict(row.attrib)
            if version == 2:
                own |= row.find("Real").attrib
            self.variables.append(own)
        by_reference = {int(v["valueReference"]): v for v in self.variables}
        if version == 2:  # derivatives name variables by their place
            of = {v["derivative"]: v for v in self.variables if "derivative" in v}
            states = [self.variables[int(place) - 1] for place in of]
            self.rates = list(of.values())
        else:
            self.rates = [v for v in self.variables if "derivative" in v]
            states = [by_reference[int(v["derivative"])] for v in self.rates]
        self.states = states
        self.n_references = max(by_reference) + 1
        assert sorted(by_reference) == list(range(self.n_references))

    def having(self, causality: str) -> list[dict[str, str]]:
        return [v for v in self.variables if v["causality"] == causality]

    def header(self, n_indicators: int, is_tied: bool, step: float) -> str:
        states, rates = self.states, self.rates
        parameters, inputs = self.having("parameter"), self.having("input")
        time, outputs = self.having("independent"), self.having("output")
        named = {v["name"] for v in (*states, *rates)}
        others = [v for v in self.having("local") if v["name"] not in named]
        unknowns = [*rates, *outputs, *others]
        knowns = [*states, *parameters, *inputs, *time]

        def flags(*chosen: dict[str, str]) -> list[int]:
            found = {int(v["valueReference"]) for v in chosen}
            return [int(i in found) for i in range(self.n_references)]

        arrays = {
            "unsigned parameters": [v["valueReference"] for v in parameters],
            "double parameter_values": [v["start"] for v in parameters],
            "unsigned inputs": [v["valueReference"] for v in inputs],
            "unsigned states": [v["valueReference"] for v in states],
            "double state_values": [v["start"] for v in states],
            "int is_exact": [int(v["initial"] == "exact") for v in states],
            "unsigned unknowns": [v["valueReference"] for v in unknowns],
            "unsigned knowns": [v["valueReference"] for v in knowns],
            "char may_be_unknown": flags(*unknowns),
            "char may_be_known": flags(*knowns),
            "char may_set": flags(*states, *parameters, *inputs),
            "char may_read_early": flags(*states, *parameters, *inputs, *time),
        }
        counts = {
            "PARAMETERS": parameters, "INPUTS": inputs, "STATES": states, "RATES": rates,
            "UNKNOWNS": unknowns, "KNOWNS": knowns,
        }  # fmt: skip
        lines = [f'#define TOKEN "{self.token}"', f"#define T_END {self.t_end!r}"]
        lines += [f"#define N_{name} {len(rows)}" for name, rows in counts.items()]
        lines += [
            f"#define N_REFERENCES {self.n_references}",
            f"#define N_INDICATORS {n_indicators}",
            f"#define IS_TIED {int(is_tied)}",
            f"#define IS_SENSITIVE {int(is_tied)}",
            f"#define LARGEST_STEP {step * self.t_end!r}",
        ]
        for name, values in arrays.items():
            # An array of C has an entry at least.
            text = ", ".join(map(str, values or [0]))
            lines.append(f"static const {name}[] = {{{text}}};")
        return "\n".join(lines) + "\n"


def _driver(folder: Path, name: str, version: int, level: str) -> Path:
    """Compile the driver with the sources of a unit."""
    need("gcc")
    is_tied, step = SCENES[name]
    model = cotree.load(name).compile()
    model.export_fmu(folder / "unit.fmu", version, platforms=[])
    with zipfile.ZipFile(folder / "unit.fmu") as archive:
        archive.extractall(folder)
        text = archive.read("modelDescription.xml").decode()
    sources = folder / "sources"
    n_events = len(model.kernels.layout.events)
    (sources / "unit_facts.h").write_text(Facts(text, version).header(n_events, is_tied, step))
    compile_ = ["gcc", "-std=c11", level, "-g", *SANITIZE, "-fno-omit-frame-pointer"]
    compile_ += ["-Wall", "-Wextra", "-Werror"]
    units = [path.name for path in sorted(sources.glob("*.c"))]
    for file in ("fmi_calls.c", "fmi_calls.h"):
        shutil.copy(FOLDER / file, sources)
    # Most files of a unit do not depend on the version, so that both versions share objects.
    driver = [*compile_, "-isystem", str(HEADERS), f"-DFMI={version}", f"-DFMI{version}_Export="]
    objects = [compile_once(compile_, sources, file) for file in units]
    objects.append(compile_once(driver, sources, "fmi_calls.c"))
    run([*compile_, "-o", "calls", *objects, "-lm"], sources)
    return sources / "calls"


def _run(program: Path, first: int, n: int) -> None:
    done = subprocess.run(
        [program, str(first), str(n)], capture_output=True, text=True, timeout=1800
    )
    assert done.returncode == 0, done.stderr[-6000:]
    assert f"{n} sequences" in done.stdout


#: The first sequence of each version: they share most of their C, so that each takes one half of
#: the sequences. With --campaign each takes all.
FIRST = {3: 1, 2: 501}


@pytest.mark.compiler
@pytest.mark.parametrize(
    ("name", "version", "first", "n"),
    [
        ("bouncing-ball", 3, 1, 20),
        *(
            # A robot's evaluations take most of the time of all.
            pytest.param(
                name, version, first, 100 if name == "robot-arm" else 500, marks=pytest.mark.slow
            )
            for name in SCENES
            for version, first in FIRST.items()
        ),
        *(
            pytest.param(name, v, 1, 1000, marks=[pytest.mark.slow, pytest.mark.campaign])
            for name in SCENES
            for v in FIRST
        ),
    ],
)
def test_any_sequence_of_calls_is_done_or_refused_with_a_message(tmp_path, name, version, first, n):
    # A sanitizer takes a compiler longer at -O1 than a few sequences take at -O0.
    _run(_driver(tmp_path, name, version, "-O1" if n >= 100 else "-O0"), first, n)
