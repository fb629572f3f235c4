from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from c_programs import SANITIZE, STRICT, execute, need, run

from cotree.codegen.c_files import method_files
from cotree.codegen.render import with_runtime


@pytest.fixture(scope="module", params=["gcc", pytest.param("clang", marks=pytest.mark.slow)])
def compiler(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a compiler that has its sanitizers."""
    name = need(request.param)
    folder = tmp_path_factory.mktemp("probe")
    (folder / "probe.c").write_text("int main(void) { return 0; }\n")
    if execute([name, *SANITIZE, "-o", "probe", "probe.c"], folder).returncode:
        pytest.skip(f"{name} has no sanitizers")
    return name


@pytest.fixture(scope="module")
def driver(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the cases of the integrator."""
    folder = tmp_path_factory.mktemp("driver")
    for name, text in with_runtime(method_files("dopri5")).items():
        (folder / name).write_text(text)
    shutil.copy(Path(__file__).with_name("dopri5_driver.c"), folder)
    sources = ["dopri5_driver.c", "cotree_dopri5.c", "cotree_integrator.c", "-lm"]
    run([compiler, "-std=c99", "-O1", *STRICT, *SANITIZE, "-o", "driver", *sources], folder)
    return folder
