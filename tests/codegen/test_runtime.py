"""The C of the runtime: modules, conditions of the preprocessor, constants shared with Python."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from cotree.codegen.c_files import STEPPERS, SUNDIALS, engine_files, method_files
from cotree.codegen.render import ALL, header_text, resolve, with_runtime
from cotree.codegen.statuses import EVENT_FAILURES, SENTENCES, TURNED
from cotree.codegen.targets import DOUBLE, SINGLE
from cotree.errors import CodegenError
from cotree.files import template_folder
from cotree.tolerances import LIMITS

RUNTIME = template_folder() / "runtime"
#: Limits that are shares of the digits of a number.
SHARES = ("small_correction", "largest_residual", "planned_pivots")


def test_no_file_of_the_runtime_is_a_template():
    for path in RUNTIME.rglob("*.[ch]"):
        text = path.read_text("ascii")
        assert "{{" not in text, path.name
        assert "{%" not in text, path.name


def test_limits_are_those_of_python():
    found = dict(re.findall(r"^#define COTREE_(\w+) (.+)$", header_text("cotree_limits.h"), re.M))
    for name, value in LIMITS._asdict().items():
        text = found[name.upper()]
        if name in SHARES:
            double, single = re.fullmatch(r"COTREE_SELECT\((\S+), (\S+)f\)", text).groups()
            assert float(double) == value
            assert f"{single}f" == SINGLE.share(value)
        else:
            assert float(re.sub(r"COTREE_F\((.*)\)", r"\1", text)) == value


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("cotree_integrator.h", dict(enumerate(SENTENCES))),
        ("cotree_events.h", EVENT_FAILURES),
    ],
    ids=["integrators", "events"],
)
def test_statuses_are_those_of_python(header, names):
    numbers = re.findall(r"\bCOTREE_(\w+) =\s*(-?\d+)", header_text(header))
    assert names.items() <= {int(number): name for name, number in numbers}.items()


def test_sentences_are_those_of_python():
    files = with_runtime({"main.c": '#include "cotree_integrator.h"\n'})
    # Long strings are cut.
    text = re.sub(r'"\s*"', "", files["cotree_integrator.c"])
    for name, sentence in SENTENCES.items():
        assert f'"{sentence}"' in text, name


def test_a_corner_that_a_parameter_moves_apart_has_the_status_of_python():
    text = header_text("cotree_run.h")
    assert int(re.search(r"#define COTREE_RUN_TURNED (\d+)", text)[1]) == TURNED


@pytest.mark.parametrize("name", STEPPERS)
def test_each_method_declares_its_stepper(name):
    files = {**engine_files(name)}
    header = "cotree_sundials.h" if name in SUNDIALS else f"cotree_{name}.h"
    assert f"cotree_stepper *cotree_{name}_stepper(void);" in files[header]


def test_conditions_are_decided():
    text = "a\n#if COTREE_X\nb\n#if OTHER\nc\n#endif\n#else\nd\n#endif\n#if !COTREE_X\ne\n#endif\n"
    assert resolve(text, {"COTREE_X": True}) == "a\nb\n#if OTHER\nc\n#endif\n"
    assert resolve(text, {"COTREE_X": False}) == "a\nd\ne\n"
    assert resolve(text, {}) == text
    both = "#if COTREE_X && !COTREE_Y\na\n#endif\n#if COTREE_X || COTREE_Y\nb\n#endif\n"
    assert resolve(both, {"COTREE_X": True, "COTREE_Y": False}) == "a\nb\n"
    assert resolve(both, {"COTREE_X": True, "COTREE_Y": True}) == "b\n"
    assert resolve(both, {"COTREE_X": False, "COTREE_Y": False}).strip() == ""
    assert resolve(both, {"COTREE_X": True}) == both  # not known
    default = "#ifndef COTREE_X\n#define COTREE_X 0\n#endif\na\n"
    assert resolve(default, {"COTREE_X": True}) == "a\n"


def test_features_have_defaults():
    """So that the files compile by themselves, with everything."""
    text = (RUNTIME / "run" / "cotree_real.h").read_text("ascii")
    defaults = re.findall(r"#ifndef (COTREE_HAS_\w+)\n(?:/\*.*\*/\n)?#define \1 1\b", text)
    assert {*defaults} == {*ALL.macros()}
    used = {
        name
        for path in RUNTIME.rglob("*.[ch]")
        for line in re.findall(r"^#if .*", path.read_text("ascii"), re.MULTILINE)
        for name in re.findall(r"COTREE_HAS_\w+", line)
    }
    assert used == {*ALL.macros()}


def test_single_precision_is_decided():
    text = header_text("cotree_real.h", SINGLE)
    assert "typedef float cotree_real;" in text
    assert not re.search(r"\bdouble\b", re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL))
    assert "typedef double cotree_real;" in header_text("cotree_real.h", DOUBLE)


def test_modules_come_with_what_they_include():
    files = with_runtime(method_files("dopri5"))
    assert {"cotree_dopri5.c", "cotree_integrator.c", "cotree_real.h", "cotree_limits.h"} <= {
        *files
    }
    assert "cotree_events.c" not in files


def test_a_header_that_is_missing_is_an_error():
    with pytest.raises(CodegenError, match=r"no file cotree_missing\.h"):
        header_text("cotree_missing.h")


#: Sources by what is defined before them.
VARIANTS = [(path, ()) for path in sorted(RUNTIME.rglob("*.c"))] + [
    (path, definitions)
    for path in sorted((RUNTIME / "sundials").glob("*.c"))
    for definitions in (
        ("COTREE_IDA=1",),
        ("COTREE_SENSITIVITIES=1",),
        ("COTREE_IDA=1", "COTREE_SENSITIVITIES=1"),
    )
]


@pytest.mark.compiler
@pytest.mark.parametrize(
    ("path", "definitions"), VARIANTS, ids=[f"{p.stem}-{'-'.join(d)}" for p, d in VARIANTS]
)
def test_each_source_compiles_by_itself(path, definitions, tmp_path):
    """As an editor or an analyser reads it: with the headers beside it, and nothing generated."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no compiler")
    (tmp_path / "cotree_abi.h").write_text(header_text("cotree_abi.h"))
    folders = [
        f"-I{folder}" for folder in (tmp_path, *sorted({p.parent for p in RUNTIME.rglob("*.h")}))
    ]
    flags = ["-std=c99", "-O0", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"]
    defined = [f"-D{definition}" for definition in definitions]
    command = [compiler, *flags, *defined, *folders, str(path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


#: Folders of what a project may have, each with the features that none of its files is without.
_PARTS = {"run": (), "job": (), "start": (), "stiff": ("IMPLICIT",), "hybrid": ("EVENTS",)}


@pytest.mark.compiler
@pytest.mark.parametrize("off", [*(name for name in ALL.macros()), "all"])
def test_sources_compile_without_a_feature(off, tmp_path):
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no compiler")
    names = [*ALL.macros()] if off == "all" else [off]
    (tmp_path / "cotree_abi.h").write_text(header_text("cotree_abi.h"))
    folders = [
        f"-I{folder}" for folder in (tmp_path, *sorted({p.parent for p in RUNTIME.rglob("*.h")}))
    ]
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"]
    for folder, needed in _PARTS.items():
        defined = [
            f"-D{name}=0" for name in names if name.removeprefix("COTREE_HAS_") not in needed
        ]
        sources = sorted(map(str, (RUNTIME / folder).glob("*.c")))
        command = [compiler, *flags, *defined, *folders, *sources]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
