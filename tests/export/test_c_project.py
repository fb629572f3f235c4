from __future__ import annotations

import dataclasses
import os
import re
from typing import TYPE_CHECKING

import pytest
from hard_scenes import bennett_loop

from cotree.codegen.tableaus import RosenbrockTableau, Tableau
from cotree.errors import CodegenError, ParameterError, SceneError
from cotree.export.c_project import (
    CProject,
    Kit,
    KitContext,
    MainContext,
    held_parameters,
    write_c_project,
)
from cotree.files import template_folder
from cotree.pipeline import formulate, generate
from cotree.scene.description import SceneDescription
from cotree.scene.toml_file import load_scene

if TYPE_CHECKING:
    from pathlib import Path

    from cotree.program.program import Program

NAMES = [
    "cotree_abi.h",
    "cotree_limits.h",
    "cotree_numbers.h",
    "cotree_real.h",
    "spring_mass_damper.h",
    "spring_mass_damper.c",
    "cotree_run.h",
    "cotree_run.c",
    "cotree_integrator.h",
    "cotree_integrator.c",
    "cotree_dopri5.h",
    "cotree_dopri5.c",
    "cotree_history.h",
    "cotree_interpolation.h",
    "cotree_history.c",
    "cotree_job.h",
    "cotree_job.c",
    "cotree_stepper.h",
    "cotree_dopri5_stepper.c",
    "main.c",
    "CMakeLists.txt",
    "Makefile",
    "spring_mass_damper.pc.in",
]


@pytest.fixture(scope="module")
def program() -> Program:
    _, equations, _ = formulate(load_scene("spring-mass-damper", SceneDescription), ("k",), None)
    return generate(equations)[0]


@pytest.fixture(scope="module")
def constrained() -> Program:
    """A free body on a rod to the ground: a loop and a quaternion."""
    scene = SceneDescription("swing", gravity=[0, 0, -9.81])
    scene.parameter("L", 1.25)
    start = {"x": 0.75, "y": 0, "z": "-sqrt(L**2 - 0.75**2)", "vx": 0.4, "vy": 0.5}
    scene.edge("f", "free", "ground", "A", initial=start)
    scene.edge("rod", "distance", "ground", "A", length="L")
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0, inertia=0.1)
    return generate(formulate(scene, ("L",), ["f"])[1])[0]


def renamed(program: Program, name: str) -> Program:
    return dataclasses.replace(program, layout=dataclasses.replace(program.layout, name=name))


def write(program: Program, folder: Path, t_end: float = 10.0, rtol: float = 1e-8) -> CProject:
    return write_c_project(program, folder, t_end=t_end, rtol=rtol, atol=1e-10)


def test_files_and_command(program: Program, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    project = write(program, folder)
    assert project.directory == folder
    assert sorted(path.name for path in project.files) == sorted(NAMES)
    assert sorted(os.listdir(folder)) == sorted(NAMES)  # and no temporary one
    assert project.command == (
        "cc -std=c99 -O2 -ffp-contract=off -o spring_mass_damper "
        "spring_mass_damper.c cotree_dopri5.c cotree_dopri5_stepper.c cotree_history.c "
        "cotree_integrator.c cotree_job.c cotree_run.c main.c -lm"
    )
    main = (folder / "main.c").read_text()
    assert "with make" in main[: main.index("*/")]
    assert "request = {\n    .t_end = 10.0,\n    .rtol = 1e-08,\n    .atol = 1e-10,\n" in main


@pytest.mark.parametrize(
    ("name", "added", "present", "absent"),
    [
        ("slider-pendulum", [], ["cotree_pack"], ["cotree_run_project_all", "input_function"]),
        ("bouncing-ball", ["cotree_events", "cotree_jumps"], [], ["cotree_run_project_all"]),
        (
            "motor-linkage",
            [
                "cotree_assembly",
                "cotree_iteration",
                "cotree_least",
                "cotree_singularity",
                "cotree_start",
            ],
            ["cotree_run_project_all"],
            ["newton_from_guess", "elimination"],
        ),
        (
            "bridge-rectifier",
            [
                "cotree_assembly",
                "cotree_breakpoints",
                "cotree_iteration",
                "cotree_least",
                "cotree_lu",
                "cotree_start",
            ],
            ["newton_from_guess"],
            ["sensitivity_projection"],
        ),
    ],
)
def test_a_project_has_what_its_model_uses(
    tmp_path: Path, name: str, added: list[str], present: list[str], absent: list[str]
) -> None:
    sensitivities = ("L",) if name == "slider-pendulum" else ()
    _, equations, _ = formulate(load_scene(name, SceneDescription), sensitivities, None)
    project = write(generate(equations)[0], tmp_path)
    modules = {path.stem for path in project.files if path.suffix == ".c"}
    common = ["dopri5", "dopri5_stepper", "history", "integrator", "job", "run"]
    assert {stem for stem in modules if stem.startswith("cotree_")} == {
        *added,
        *(f"cotree_{stem}" for stem in common),
    }
    run = "".join((tmp_path / f"cotree_run.{end}").read_text() for end in "hc")
    assert [word for word in present if word not in run] == []
    assert [word for word in absent if word in run] == []
    assert not any("COTREE_HAS_" in path.read_text() for path in project.files)


def test_constraints_add_a_start_and_a_projection(
    program: Program, constrained: Program, tmp_path: Path
) -> None:
    """No compiler is needed to find the start; a model without constraints has none of it."""
    free, held = (
        (write(p, tmp_path / p.layout.name).directory / "main.c").read_text()
        for p in (program, constrained)
    )
    assert "cotree_start_once(" not in free
    assert "cotree_start_once(" in held
    assert "MODEL->initial(" in free
    assert "MODEL->initial(" not in held


def test_start_that_violates_the_constraints_is_refused(tmp_path: Path) -> None:
    scene = SceneDescription("swing")
    scene.edge("f", "planar", "ground", "A", normal=[0, 0, 1], initial={"x": 3, "y": 0})
    scene.edge("rod", "distance", "ground", "A", length=2.0)
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0, inertia=0.1)
    program = generate(formulate(scene, (), ["f"])[1])[0]
    with pytest.raises(ParameterError, match="rod"):
        write(program, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_same_program_gives_same_bytes(program: Program, tmp_path: Path) -> None:
    first, second = (write(program, tmp_path / name) for name in "ab")
    for one, other in zip(first.files, second.files, strict=True):
        assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize("which", ["program", "constrained"])
def test_files_are_ascii_with_short_lines(
    request: pytest.FixtureRequest, tmp_path: Path, which: str
) -> None:
    for path in write(request.getfixturevalue(which), tmp_path).files:
        lines = path.read_text(encoding="ascii").splitlines()
        if path.name in ("main.c", "cotree_dopri5.h", "cotree_dopri5.c"):
            long = [line for line in lines if len(line) > 100 and " cc " not in line]
            assert not long, path.name
        assert not [line for line in lines if line != line.rstrip()], path.name


def test_old_files_are_replaced_and_others_kept(program: Program, tmp_path: Path) -> None:
    (tmp_path / "main.c").write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    write(program, tmp_path)
    assert (tmp_path / "main.c").read_text() != "old"
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_link_is_replaced_and_not_followed(program: Program, tmp_path: Path) -> None:
    target = tmp_path / "target"
    target.write_text("kept")
    folder = tmp_path / "folder"
    folder.mkdir()
    try:
        (folder / "main.c").symlink_to(target)
    except OSError:
        pytest.skip("no symbolic links here")
    write(program, folder)
    assert target.read_text() == "kept"
    assert not (folder / "main.c").is_symlink()


def test_file_in_place_of_the_folder_is_named(program: Program, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("kept")
    for folder in (path, path / "below"):
        with pytest.raises(CodegenError, match=re.escape(str(folder))):
            write(program, folder)
    assert path.read_text() == "kept"


def test_folder_in_place_of_a_file_leaves_nothing_behind(program: Program, tmp_path: Path) -> None:
    (tmp_path / "cotree_abi.h").mkdir()
    with pytest.raises(CodegenError, match="cannot be written"):
        write(program, tmp_path)
    assert os.listdir(tmp_path) == ["cotree_abi.h"]


@pytest.mark.parametrize(
    "name", ["main", "Main", "Makefile", "clean", "cotree-dopri5", "cotree_abi"]
)
def test_scene_with_the_name_of_a_project_file(program: Program, tmp_path: Path, name: str) -> None:
    """The model's own files step aside, so that none takes the place of another."""
    project = write(renamed(program, name), tmp_path)
    stems = [path.name.lower() for path in project.files]
    assert len(set(stems)) == len(stems) == len(NAMES)
    prefix = name.replace("-", "_")
    assert f"{prefix}_.c" in {path.name for path in project.files}


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_numbers_that_are_none(program: Program, tmp_path: Path, value: float) -> None:
    with pytest.raises(SceneError, match="t_end is"):
        write(program, tmp_path, t_end=value)
    with pytest.raises(SceneError, match="rtol is"):
        write(program, tmp_path, rtol=value)
    with pytest.raises(SceneError, match="rtol is -1"):
        write(program, tmp_path, rtol=-1.0)


@pytest.mark.parametrize(
    ("template", "name", "contexts"),
    [
        ("main/main.c.jinja", "main", [MainContext]),
        ("kit/*", "kit", [KitContext]),
        ("integrators/[elrv]*.jinja", "method", [Tableau, RosenbrockTableau]),
    ],
)
def test_template_uses_every_field_of_its_context(
    template: str, name: str, contexts: list[type]
) -> None:
    text = "".join(path.read_text() for path in (template_folder() / "c").glob(template))
    tags = " ".join(re.findall(r"\{[{%](.*?)[}%]\}", text))
    used = set(re.findall(rf"\b{name}\.(\w+)", tags))
    fields = {field.name for context in contexts for field in dataclasses.fields(context)}
    known = {entry for context in contexts for entry in vars(context)}
    assert used - (known - fields) == fields


def test_integrators_that_are_refused(program: Program, tmp_path: Path) -> None:
    with pytest.raises(CodegenError, match=r"no integrator 'dopri6'.*'dopri5'"):
        write_c_project(program, tmp_path, "dopri6", t_end=1.0, rtol=1e-6, atol=1e-8)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_stiff_methods_refuse_dependent_constraints(tmp_path: Path) -> None:
    with pytest.raises(CodegenError, match="dependent at the start, which rodas5 does not support"):
        bennett_loop().compile().write(tmp_path, "rodas5")
    assert not list(tmp_path.iterdir())


def test_kits_that_are_refused(program: Program, tmp_path: Path) -> None:
    numbers = {"t_end": 1.0, "rtol": 1e-6, "atol": 1e-8}
    for kit, match in (
        (Kit("dopri5,rk4"), "rk4 has fixed steps"),
        (Kit("dopri5,dopri5"), "'dopri5' is named twice"),
        (Kit(real="half"), "no type 'half' of numbers: give double or float"),
        (Kit(prefix="int"), "'int' cannot be the prefix"),
        (Kit(prefix="a b"), "'a b' cannot be the prefix"),
        (Kit(prefix="cotree_x"), "'cotree_x' cannot be the prefix"),
    ):
        with pytest.raises(CodegenError, match=match):
            write_c_project(program, tmp_path, kit, **numbers)
    assert not list(tmp_path.iterdir())


def test_prefix_replaces_the_name_of_the_scene(program: Program, tmp_path: Path) -> None:
    project = write_c_project(
        program, tmp_path, Kit(prefix="plant"), t_end=1.0, rtol=1e-6, atol=1e-8
    )
    texts = {path.name: path.read_text() for path in project.files}
    assert "plant_rhs(" in texts["plant.h"]
    assert not any("spring_mass_damper" in text for text in texts.values())


def test_single_precision_has_no_double(program: Program, tmp_path: Path) -> None:
    """Constants and functions end in f; the main program converts where it prints."""
    kit = Kit("dopri5,rodas5", "float")
    project = write_c_project(program, tmp_path, kit, t_end=1.0, rtol=1e-8, atol=1e-10)
    for path in project.files:
        if path.suffix in (".c", ".h"):
            text = re.sub(r'/\*.*?\*/|"(?:\\.|[^"])*"', "", path.read_text(), flags=re.DOTALL)
            # Macros add the suffix, or choose the number of the type.
            text = re.sub(r"COTREE_F\([^()]*\)|COTREE_SELECT\([^()]*\)", "", text)
            assert not re.search(r"\bdouble\b|\bDBL_|\b(sin|cos|sqrt|pow|fabs)\(", text), path.name
            numbers = re.findall(r"(?<![\w.])\d+\.\d*(?:e[-+]?\d+)?(?![\w.])", text)
            assert not numbers, (path.name, numbers)
    # Tolerances are loosened together to what single precision meets.
    options = "    .t_end = 1.0f,\n    .rtol = 2e-05f,\n    .atol = 2.0000000000000002e-07f,\n"
    assert options in (tmp_path / "main.c").read_text()


def test_parameter_beyond_single_precision_is_named(tmp_path: Path) -> None:
    scene = SceneDescription("tiny")
    scene.parameter("c", 1e-50)
    scene.edge("C", "capacitor", "a", "ground", capacitance="c", initial={"v": 1.0})
    scene.edge("R", "resistor", "a", "ground", resistance=1e50)
    program = generate(formulate(scene, (), None)[1])[0]
    with pytest.raises(CodegenError, match=r"parameter 'c' is 1e-50, beyond the range of float"):
        write_c_project(program, tmp_path, Kit(real="float"), t_end=1.0, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", ["motor-linkage", "bridge-rectifier", "heated-room", "crane"])
def test_parameters_that_are_not_held_leave_the_start_alone(name: str) -> None:
    """The main program takes others for these only; the start is computed before."""
    import numpy as np

    import cotree

    model = cotree.load(name).compile([])
    program = model.kernels.program
    is_sought = bool(program.layout.constraints or program.layout.n_algebraic)
    held = held_parameters(program, has_start=is_sought)
    start = model.start().y
    for i, parameter in enumerate(program.layout.parameters):
        if i not in held:
            value = program.layout.parameter_values[i]
            moved = model.start(p={parameter.name: 1.01 * value + 1e-3 * (value == 0.0)}).y
            # Up to the rounding that a search for the start leaves.
            np.testing.assert_allclose(moved, start, rtol=1e-12, atol=1e-12, err_msg=parameter.name)
    if name == "motor-linkage":
        assert 0 < len(held) < len(program.layout.parameters)
