"""Members as threads of a graphics processor: the same text on the processor, and its compilation.

Numbers need such a processor; the last test runs where there is one.
"""

from __future__ import annotations

import ctypes
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rod_chain import rod_chain

import cotree
from cotree.build import find_toolchain
from cotree.ensemble import cuda
from cotree.ensemble.batch import run_block
from cotree.ensemble.plan import Plan
from cotree.errors import SolveError
from cotree.solvers.settings import Settings

pytestmark = pytest.mark.compiler

TIMES = np.linspace(0.0, 1.0, 5)
COLUMNS = ("L", "k", "j1.s")


class OnProcessor:
    """The machine of the text where it was compiled as C++: threads run one after another."""

    def __init__(self, text: str, folder: Path) -> None:
        (folder / "members.cpp").write_text(text)
        # No fused products, as everywhere else.
        command = ["g++", "-O0", "-ffp-contract=off", "-DCOTREE_CUDA_ON_HOST", "-fPIC", "-shared"]
        # A warning may be of a macro that two sources define.
        command.append("-Werror")
        subprocess.run([*command, "members.cpp", "-o", "members.so"], cwd=folder, check=True)
        self.library = ctypes.CDLL(str(folder / "members.so"))
        self.thread = ctypes.c_int.in_dll(self.library, "cotree_cuda_thread")
        self.kept = {}

    def put(self, data):
        array = np.frombuffer(data, dtype=np.uint8).copy()
        self.kept[array.ctypes.data] = array
        return array.ctypes.data

    def make_room(self, n_bytes):
        return self.put(bytes(n_bytes))

    def fetch(self, address, n_bytes):
        return bytes(self.kept[address][:n_bytes])

    def launch(self, name, n_threads, arguments):
        kinds = {"uintp": ctypes.c_void_p, "uint64": ctypes.c_void_p, "int64": ctypes.c_long}
        given = [kinds.get(a.dtype.name, ctypes.c_int)(a.item()) for a in arguments]
        for self.thread.value in range(n_threads):
            getattr(self.library, name)(*given)


def plan_of(outputs=(), model=None, columns=COLUMNS):
    model = model or cotree.load("slider-pendulum").compile(["L"])
    settings = Settings((0.0, 1.0), TIMES, "dop853", 1e-8, 1e-10)
    return Plan(model, settings, columns, outputs, lanes=1)


def rows():
    draw = np.random.default_rng(1).uniform(0.9, 1.1, (7, 3))
    return draw * [1.0, 50.0, 0.5]


def test_threads_give_what_members_one_by_one_give(tmp_path):
    if find_toolchain().is_clang:
        pytest.skip("g++ is called here")
    model = cotree.load("slider-pendulum").compile(["L"])
    plan, members = plan_of(outputs=model.outputs), rows()
    members[3, 0] = -1.0  # a rod of negative length is not refused, but it is another model's
    members[4, 1] = np.nan
    pattern = cuda.fitting_pattern(plan)
    machine = OnProcessor(cuda.pattern_text(pattern), tmp_path)
    found, right = cuda.run_block_on(machine, pattern, members), run_block(plan, members)
    np.testing.assert_array_equal(found.status, right.status)
    assert found.messages == right.messages
    # Steps are chosen by errors of 1e-8; what the compilers round otherwise is far below that.
    for name in ("z", "outputs", "output_sensitivities"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(right, name), rtol=1e-11, atol=1e-12
        )
    assert found.status[4] != 0
    np.testing.assert_array_equal(found.steps, right.steps)


def test_threads_take_models_whose_kernels_use_vectors(tmp_path):
    if find_toolchain().is_clang:
        pytest.skip("g++ is called here")
    scene, wanted = rod_chain(3)
    model = scene.compile(wanted[:1])
    assert any(name.endswith("_vectors.h") for name in model._compiled.text.files)
    plan = plan_of(model=model, columns=wanted[:1])
    pattern, members = cuda.fitting_pattern(plan), np.array([[0.9], [1.0], [1.1]])
    machine = OnProcessor(cuda.pattern_text(pattern), tmp_path)
    found, right = cuda.run_block_on(machine, pattern, members), run_block(plan, members)
    assert not found.status.any()
    np.testing.assert_allclose(found.z, right.z, rtol=1e-9, atol=1e-11)


def test_functions_of_one_name_take_different_structures():
    """C++ then tells them apart wherever they are called: no structure stands for another."""
    text = cuda.pattern_text(cuda.fitting_pattern(plan_of()))
    found = re.findall(r"^COTREE_STATIC [^;{]*?(\w+)\(([^,)]*)[^;{]*\)\n\{", text, re.MULTILINE)
    kinds = [(name, first.removeprefix("const ").split()[0]) for name, first in found]
    assert len(kinds) > 250  # all functions of the engine
    assert len(set(kinds)) == len(kinds)


@pytest.mark.parametrize(
    ("scene", "method", "why"),
    [
        ("slider-pendulum", "rodas5", "is no explicit method"),
        ("slider-pendulum", "RK45", "runs in Python"),
        ("bouncing-ball", "dop853", "it has events"),
    ],
)
def test_what_threads_cannot_run_is_refused(scene, method, why):
    settings = Settings((0.0, 1.0), TIMES, method)
    with pytest.raises(SolveError, match=f"cannot run on a graphics processor: .*{why}"):
        cuda.run_block_on_cuda(Plan(cotree.load(scene).compile(), settings, ("g",)), [[9.81]])


def test_ensembles_take_the_device(monkeypatch):
    monkeypatch.setitem(sys.modules, "cupy", None)
    model = cotree.load("slider-pendulum").compile()
    with pytest.raises(SolveError, match="device is 'gpu': give 'cpu' or 'cuda'"):
        model.ensemble((0.0, 1.0), {"L": [1.0, 1.1]}, device="gpu")
    with pytest.raises(SolveError, match=r"cotree\[cuda\]"):
        model.ensemble((0.0, 1.0), {"L": [1.0, 1.1]}, method="dopri5", device="cuda")


def test_without_cupy_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "cupy", None)
    with pytest.raises(SolveError, match=r"pip install cotree\[cuda\]"):
        cuda.run_block_on_cuda(plan_of(), rows())


def compiled_by_nvrtc(text):
    """The status and the messages of NVIDIA's compiler, which needs no graphics processor."""
    found = importlib.util.find_spec("nvidia.cuda_nvrtc") if _has("nvidia") else None
    if found is None:
        pytest.skip("no NVRTC: pip install nvidia-cuda-nvrtc-cu12")
    folder = Path(next(iter(found.submodule_search_locations))) / "lib"
    for library in sorted(folder.glob("libnvrtc-builtins.so*")):
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
    nvrtc = ctypes.CDLL(str(next(folder.glob("libnvrtc.so*"))))
    program, size = ctypes.c_void_p(), ctypes.c_size_t()
    nvrtc.nvrtcCreateProgram(ctypes.byref(program), text.encode(), b"members.cu", 0, None, None)
    options = [option.encode() for option in cuda.OPTIONS]
    status = nvrtc.nvrtcCompileProgram(
        program, len(options), (ctypes.c_char_p * len(options))(*options)
    )
    nvrtc.nvrtcGetProgramLogSize(program, ctypes.byref(size))
    log = ctypes.create_string_buffer(size.value)
    nvrtc.nvrtcGetProgramLog(program, log)
    return status, log.value.decode()


def _has(name):
    return importlib.util.find_spec(name) is not None


@pytest.mark.slow  # the compiler takes five seconds
def test_the_text_compiles_for_graphics_processors():
    status, log = compiled_by_nvrtc(cuda.pattern_text(cuda.fitting_pattern(plan_of())))
    assert status == 0, log


def test_a_graphics_processor_gives_the_same():
    cupy = pytest.importorskip("cupy")
    try:
        cupy.cuda.runtime.getDeviceCount()
    except cupy.cuda.runtime.CUDARuntimeError as error:
        pytest.skip(f"no graphics processor: {error}")
    plan = plan_of()
    found, right = cuda.run_block_on_cuda(plan, rows()), run_block(plan, rows())
    # The functions of CUDA's library differ from those of C by a few units in the last place.
    np.testing.assert_allclose(found.z, right.z, rtol=1e-9, atol=1e-10)
