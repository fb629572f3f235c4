"""Random sequences of legal and illegal calls, under the address sanitizer."""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cotree

DRIVER = Path(__file__).with_name("fmu_driver.c")
FLAGS = ["-std=c99", "-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]

# A run as it should be: each call, with bytes that make it legal.
EXCHANGE = [(0, 2, 0), (0, 2, 5), (1, 2, 0), (17, 2, 0), (19, 2, 0), (22, 2, 0), (24, 2, 16)]
STEPS = [(0, 1, 0), (0, 1, 5), (1, 1, 0), (26, 1, 0), (26, 1, 0), (10, 1, 0), (26, 1, 0)]

CALL = st.tuples(st.integers(0, 28), st.integers(0, 255), st.integers(0, 255))
SEQUENCES = st.lists(
    st.one_of(CALL.map(lambda call: [call]), st.sampled_from([EXCHANGE, STEPS])),
    min_size=1,
    max_size=60,
)


@pytest.fixture(scope="module", params=["bouncing-ball", "bridge-rectifier", "motor-linkage"])
def driver(request, tmp_path_factory):
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    folder = tmp_path_factory.mktemp("calls")
    cotree.load(request.param).compile().export_fmu(folder / "unit.fmu", platforms=[])
    with zipfile.ZipFile(folder / "unit.fmu") as archive:
        archive.extractall(folder)
    text = (folder / "modelDescription.xml").read_text()
    token = re.search(r'instantiationToken="([^"]*)"', text).group(1)
    sources = sorted(map(str, (folder / "sources").glob("*.c")))
    program = folder / "driver"
    given = [f'-DTOKEN="{token}"', f"-I{folder / 'sources'}", "-o", str(program), str(DRIVER)]
    subprocess.run(["gcc", *FLAGS, *given, *sources, "-lm"], check=True)
    return program


def _drive(program, calls):
    data = bytes(byte for call in calls for byte in call)
    return subprocess.run([program], input=data, capture_output=True, check=False, timeout=120)


def test_runs_as_they_should_be(driver):
    # Parameters of motors and diodes are not refused, nor is anything else but the wrong mode.
    for calls in (EXCHANGE, STEPS):
        outcome = _drive(driver, calls)
        assert outcome.returncode == 0, outcome.stderr.decode()
        assert outcome.stdout.decode() == f"{len(calls)} calls, 0 refused\n"


@pytest.mark.slow
def test_no_sequence_of_calls_does_harm(driver):
    @settings(max_examples=350, suppress_health_check=list(HealthCheck), derandomize=True)
    @given(SEQUENCES)
    def run(parts):
        outcome = _drive(driver, [call for part in parts for call in part])
        # The sanitizers end with another status where memory is misused or left.
        assert outcome.returncode == 0, outcome.stdout.decode() + outcome.stderr.decode()[:3000]

    run()
