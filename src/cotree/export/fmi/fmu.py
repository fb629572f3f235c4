"""Export of a model to an FMU, and the files that it contains in addition to sources."""

from __future__ import annotations

import hashlib
import importlib.util
import io
import math
import platform
import sys
import warnings
import zipfile
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from cotree.arguments import check_names
from cotree.build import BuildOptions, Toolchain, find_toolchain
from cotree.build.compile import build_library
from cotree.codegen.c_files import INTEGRATORS
from cotree.errors import BuildError, CodegenError, SolveError, check_known
from cotree.export.c_checks import Evaluated, check_loops, check_numbers
from cotree.export.fmi.fmu_sources import FmuFacts, form_kernels, source_files
from cotree.export.fmi.model_description import Description, VariableBlocks, xml_text
from cotree.files import atomic_write, write_rows
from cotree.naming import c_identifier
from cotree.program.surfaces import strip_switching_surfaces
from cotree.quiet import level_of_user
from cotree.report import names
from cotree.sharing import forming
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from cotree.model.start import Start
    from cotree.program.program import Program
    from cotree.scene.settings import Simulation


@dataclass(frozen=True)
class Platform:
    """A platform for which an FMU may contain a library."""

    name: str  # name of the folder in FMI 3
    old_name: str  # name in FMI 2; empty if the platform does not exist there
    target: str  # target name of zig
    suffix: str  # suffix of libraries

    def folder(self, version: int) -> str:
        """Return the folder of the platform's library in an FMU."""
        return self.name if version == 3 else self.old_name


#: Platforms by name. Linux uses glibc 2.26 of 2017, which all maintained distributions have.
PLATFORMS: dict[str, Platform] = {
    row.name: row
    for row in (
        Platform("x86_64-linux", "linux64", "x86_64-linux-gnu.2.26", ".so"),
        Platform("aarch64-linux", "", "aarch64-linux-gnu.2.26", ".so"),
        Platform("x86_64-windows", "win64", "x86_64-windows-gnu", ".dll"),
        Platform("x86_64-darwin", "darwin64", "x86_64-macos", ".dylib"),
        Platform("aarch64-darwin", "", "aarch64-macos", ".dylib"),
    )
}


def this_platform() -> str | None:
    """Return the platform of this process; None if it is not in ``PLATFORMS``."""
    system = {"linux": "linux", "win32": "windows", "darwin": "darwin"}.get(sys.platform, "")
    machine = platform.machine().lower()
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    name = f"{machine}-{system}"
    return name if name in PLATFORMS else None


def wanted_platforms(names: Sequence[str] | None, version: int) -> list[Platform]:
    """Return platforms by name, by default this machine's; raise CodegenError for unknown ones."""
    if names is None:
        own = this_platform()
        if own is None or not PLATFORMS[own].folder(version):
            raise CodegenError(
                f"FMI {version} has no name for this machine: give platforms=[] for an FMU of "
                "sources, or name other platforms"
            )
        names = [own]
    if isinstance(names, str):
        names = [names]
    for name in names:
        check_known([name], PLATFORMS, "there is no platform", error=CodegenError)
        if not PLATFORMS[name].folder(version):
            raise CodegenError(f"FMI {version} has no platform '{name}': leave it out")
    return [PLATFORMS[name] for name in dict.fromkeys(names)]


def build_libraries(
    files: Mapping[str, str], platforms: Sequence[Platform], n_operations: int
) -> dict[str, bytes]:
    """Compile the sources; return the libraries by the names of their platforms.

    The operations of the longest function, ``n_operations``, determine the compiler's level.
    """
    own, libraries = this_platform(), {}
    for row in platforms:
        built = build_library(
            files,
            abi_version=ABI_VERSION,
            n_operations=n_operations,
            options=BuildOptions(),
            toolchain=_toolchain(row, is_own=row.name == own),
            flags=["-fvisibility=hidden"],
            is_windows=row.suffix == ".dll",
        )
        libraries[row.name] = built.path.read_bytes()
    return libraries


def _toolchain(row: Platform, *, is_own: bool) -> Toolchain:
    if is_own:
        found = find_toolchain()
        if found is None:
            raise BuildError(
                "a binary FMU for this machine needs a C compiler: install one, or give "
                "platforms=[] for a source-code FMU"
            )
        return found
    if importlib.util.find_spec("ziglang") is None:
        raise BuildError(f"compiling for {row.name} needs zig: run `pip install 'cotree[zig]'`")
    command = (sys.executable, "-m", "ziglang", "cc", "-target", row.target)
    return Toolchain(command, "zig", "zig")


VERSIONS = (2, 3)
KINDS = ("ModelExchange", "CoSimulation")


@dataclass(frozen=True)
class FmuChoice:
    """Options of an FMU."""

    version: int = 3  # version of FMI, 2 or 3
    kinds: tuple[str, ...] = KINDS
    integrator: str | None = None  # method of Co-Simulation; None for one that suits the model
    #: Inputs that the importer sets; None selects the inputs that are constant in the scene.
    inputs: tuple[str, ...] | None = None
    platforms: tuple[str, ...] | None = None  # platforms to compile for; None for this machine


def choose(
    version: int,
    kinds: Sequence[str] | str,
    integrator: str | None,
    inputs: Sequence[str] | None,
    platforms: Sequence[str] | None,
) -> FmuChoice:
    """Return the checked options of an FMU; raise CodegenError if one is unknown."""
    wanted = check_names(kinds, "kinds")
    if version not in VERSIONS or isinstance(version, bool):
        raise CodegenError(f"FMI version {version} is not supported: give version 2 or 3")
    check_known(wanted, KINDS, "there is no kind of FMU", error=CodegenError)
    if not wanted:
        raise CodegenError("an FMU needs a kind: give ModelExchange, CoSimulation or both")
    if integrator is not None:
        what = "an FMU cannot have the integrator"
        check_known([integrator], INTEGRATORS, what, error=CodegenError)
    return FmuChoice(
        version,
        tuple(kind for kind in KINDS if kind in wanted),
        integrator,
        None if inputs is None else check_names(inputs, "inputs"),
        None if platforms is None else check_names(platforms, "platforms"),
    )


_REFERENCES = "extra/org.fmi-standard.fmi-ls-ref"

_ICON = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}


def reference_files(
    identifier: str, times: Iterable[float], columns: Mapping[str, Iterable[float]]
) -> dict[str, bytes]:
    """Return files with expected results, in the format of the layered standard LS-REF."""
    text = io.StringIO()
    rows = zip(times, *columns.values(), strict=True)
    write_rows(text, [("time", *columns), *rows])
    # The attributes are in the namespace that FMI defines for manifests of layered standards.
    space = "http://fmi-standard.org/fmi-ls-manifest"
    ElementTree.register_namespace("fmi-ls", space)
    root = ElementTree.Element(
        "fmiReferences",
        {
            f"{{{space}}}fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
            f"{{{space}}}fmi-ls-version": "1.0.0-alpha.1",
        },
    )
    name = f"{identifier}_out.csv"
    about = {"role": "result", "description": "Output of the default experiment"}
    ElementTree.SubElement(root, "Related", {"type": "text/csv", "source": name, **about})
    return {
        f"{_REFERENCES}/{name}": text.getvalue().encode(),
        f"{_REFERENCES}/fmi-ls-manifest.xml": xml_text(root).encode(),
    }


def icon_files(figure: Figure, version: int) -> dict[str, bytes]:
    """Write the icon for importers."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=100, metadata={"Software": None})
    if version == 2:
        return {"model.png": data.getvalue()}
    root = ElementTree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    own = ElementTree.SubElement(root, "GraphicalRepresentation")
    ElementTree.SubElement(own, "CoordinateSystem", _ICON, suggestedScalingFactorTo_mm="0.1")
    ElementTree.SubElement(own, "Icon", _ICON)
    return {
        "terminalsAndIcons/icon.png": data.getvalue(),
        "terminalsAndIcons/terminalsAndIcons.xml": xml_text(root).encode(),
    }


@dataclass(frozen=True, repr=False)
class Fmu:
    """A written FMU."""

    path: Path  # path of the FMU
    version: int  # version of FMI, 2 or 3
    kinds: tuple[str, ...]  # interface types, such as ``CoSimulation``
    platforms: tuple[str, ...]  # platforms for which the FMU contains libraries
    variables: tuple[str, ...]  # names of the variables, in the order of their value references

    def __repr__(self) -> str:
        where = names(list(self.platforms)) if self.platforms else "sources only"
        return f"<Fmu {self.path}: FMI {self.version}, {' and '.join(self.kinds)}, {where}>"


def write_fmu(
    program: Program,
    path: Path,
    choice: FmuChoice,
    evaluated: Evaluated,
    numbers: tuple[float, float, float],
    *,
    rest: Start | None,
    extra: Mapping[str, bytes],
) -> Fmu:
    """Write a model as an FMU, completely or not at all.

    ``numbers`` are end time, relative and absolute tolerance of the default experiment; ``rest`` is
    the operating point at which runs begin, and ``extra`` are further files by name. Raises
    CodegenError if the model does not support the options, SceneError if the file cannot be written
    or a number is refused, and BuildError if the compiler fails.
    """
    t_end, rtol, atol = numbers
    platforms = wanted_platforms(choice.platforms, choice.version)
    check_numbers(t_end, rtol, atol)
    # Importers can locate events, but cannot freeze branches.
    program = strip_switching_surfaces(program)
    _check_calls(program)
    outside = _outside(program, choice.inputs)
    kernels = form_kernels(program, outside)
    facts = _facts(program, choice, evaluated, outside, rest, numbers)
    identifier = c_identifier(program.layout.name)
    files = source_files(program, kernels, facts, choice.version)
    # The token is a digest of the sources, which contain it, so they are rendered twice.
    token = _token(files, choice)
    files = source_files(program, kernels, replace(facts, token=token), choice.version)
    listing = VariableBlocks(program.layout, kernels, outside, facts.has_sensitivities)
    variables = listing.listed(facts.input_values, facts.start, is_found=facts.is_found)
    description = Description(
        choice.version,
        choice.kinds,
        program.layout.name,
        identifier,
        token,
        variables,
        t_end,
        rtol,
        interval_of(t_end),
        tuple(sorted(name for name in files if name.endswith(".c"))),
    )
    written = {"modelDescription.xml": description.model_description().encode()}
    written |= {f"sources/{name}": text.encode("ascii") for name, text in files.items()}
    if choice.version == 3:
        written["sources/buildDescription.xml"] = description.build_description().encode()
    written |= extra
    n_longest = max(kernel.operations.total for kernel in program.kernels.values())
    n_longest = max([n_longest, *(k.operations.total for k in kernels.present)])
    for name, library in build_libraries(files, platforms, n_longest).items():
        row = next(row for row in platforms if row.name == name)
        place = f"binaries/{row.folder(choice.version)}/{identifier}{row.suffix}"
        written[place] = library
    _write_archive(path, written)
    return Fmu(
        path,
        choice.version,
        choice.kinds,
        tuple(row.name for row in platforms),
        tuple(variable.name for variable in variables.all),
    )


def _check_calls(program: Program) -> None:
    for kernel in program.kernels.values():
        for node in kernel.order:
            if node.op == "call":
                raise CodegenError(
                    f"the scene calls the external function '{node.data.name}', which an FMU does "
                    "not contain: replace it by an expression or a table"
                )


def _outside(program: Program, wanted: Sequence[str] | None) -> tuple[int, ...]:
    layout, own = program.layout, program.kernels["inputs"].results
    known = [row.name for row in layout.inputs]
    if wanted is None:
        return tuple(i for i, node in enumerate(own) if node.value is not None)
    for name in wanted:
        check_known([name], known, "the scene has no input", error=CodegenError)
        depends = layout.input_sensitivities[known.index(name)]
        if depends:
            raise CodegenError(
                f"input '{name}' depends on '{depends[0]}', to which sensitivities are compiled: "
                "an importer cannot set it; leave it out of inputs, or compile without this "
                "sensitivity"
            )
    return tuple(i for i, name in enumerate(known) if name in wanted)


def _facts(
    program: Program,
    choice: FmuChoice,
    evaluated: Evaluated,
    outside: tuple[int, ...],
    rest: Start | None,
    numbers: tuple[float, float, float],
) -> FmuFacts:
    layout = program.layout
    t_end, rtol, atol = numbers
    has_steps = "CoSimulation" in choice.kinds
    is_exchangeable = "ModelExchange" in choice.kinds
    is_dependent = evaluated.is_dependent()
    integrator = ""
    if has_steps:
        # Explicit methods would solve for algebraic unknowns in each stage.
        is_stiff = bool(layout.n_algebraic) and not is_dependent
        integrator = choice.integrator or ("rodas5" if is_stiff else "dopri5")
        if INTEGRATORS[integrator].is_implicit:
            check_loops(program, integrator, is_dependent)
    start, u = rest or evaluated.start, evaluated.initial("inputs")
    return FmuFacts(
        token="",
        integrator=integrator,
        is_exchangeable=is_exchangeable,
        # FMUs for Model Exchange do not integrate sensitivities.
        has_sensitivities=bool(layout.sensitivities) and not is_exchangeable,
        is_strict=is_dependent,
        outside=outside,
        input_values=tuple(float(u[i]) for i in outside),
        start=tuple(float(value) for value in start.y),
        is_found=bool(layout.has_conditions or layout.followers or layout.n_algebraic),
        is_at_rest=rest is not None,
        sizes=tuple(evaluated.sizes(start)),
        rtol=rtol,
        atol=atol,
        t_end=t_end,
    )


def _token(files: Mapping[str, str], choice: FmuChoice) -> str:
    """Return a token in the form of a GUID: a digest of all that is compiled."""
    text = "\n".join([*choice.kinds, *(f"{name}\n{files[name]}" for name in sorted(files))])
    digest = hashlib.sha256(text.encode()).hexdigest()
    parts = (digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32])
    return f"{{{'-'.join(parts)}}}"


def write_fmu_of(model: Any, path: Path, choice: FmuChoice, defaults: Simulation) -> Fmu:
    """Write a :class:`cotree.Model` as an FMU; see :meth:`cotree.Model.export_fmu`."""
    rest = model.start() if model.kernels.begins_at_rest else None
    extra = extra_files(model, choice, defaults.t_end)
    # Hold the lock: forming kernels adds nodes to the program's arena, which threads share.
    with forming:
        own = Evaluated(model.kernels.program, model.kernels)
        numbers = defaults.t_end, defaults.rtol, defaults.atol
        return write_fmu(own.program, path, choice, own, numbers, rest=rest, extra=extra)


def extra_files(model: Any, choice: FmuChoice, t_end: float) -> dict[str, bytes]:
    """Return the expected results and the icon of the FMU of a :class:`cotree.Model`."""
    from cotree.pipeline import draw_graphs
    from cotree.plot import draw_graphs as picture

    graphs, trees = draw_graphs(model.spec.scene, None)
    drawn = picture((graph, trees.get(domain)) for domain, graph in graphs.items())
    files = icon_files(drawn, choice.version)
    if model.kernels.backend != "C":
        return files
    # Inputs that the importer sets are constant at their initial values.
    begin = model.kernels.input_values(0.0)
    wanted = choice.inputs or ()
    held = {name: u for name, u in zip(model.inputs, begin, strict=True) if name in wanted}
    times = np.linspace(0.0, t_end, 1 + max(1, round(t_end / interval_of(t_end))))
    try:
        result = model.simulate((0.0, t_end), times, inputs=held, throw=True)
    except SolveError as error:
        warnings.warn(
            f"the FMU holds no expected results, since the scene's default run fails: {error}",
            RuntimeWarning,
            stacklevel=level_of_user(),
        )
        return files
    columns = {name: result[name] for name in model.outputs}
    return files | reference_files(c_identifier(model.kernels.layout.name), result.t, columns)


def interval_of(t_end: float) -> float:
    """Return a rounded communication interval, about 1/500 of the default experiment."""
    if t_end <= 0.0:
        return 1.0
    exponent = math.floor(math.log10(t_end / 500.0))
    return float(f"1e{exponent}") * next(
        (m for m in (1, 2, 5) if m * 10.0**exponent * 500.0 >= t_end), 10
    )


def _write_archive(path: Path, files: Mapping[str, bytes]) -> None:
    with (
        atomic_write(path, "the FMU") as draft,
        zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for name in sorted(files, key=lambda name: (name != "modelDescription.xml", name)):
            # A fixed date makes the bytes of the FMU reproducible.
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, files[name])
