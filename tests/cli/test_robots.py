"""Every command takes a URDF file, and says what it did not read."""

from __future__ import annotations

import re

import pytest
from urdf_texts import WHOLE

from cotree.cli import main


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "whole.urdf"
    path.write_text(WHOLE, encoding="utf-8")
    return str(path)


@pytest.mark.sampled(1)
@pytest.mark.compiler
@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["run", "ROBOT", "--t-end", "0.1", "--set", "g=1.6"], r"shoulder_joint\.theta +="),
        (
            ["run", "ROBOT", "--t-end", "0.1", "-s", "slider_mass"],
            r"d\(slide\.s\)/d\(slider_mass\)",
        ),
        (["graph", "ROBOT"], "shoulder_joint_frame -> upper_arm"),
        (["check", "ROBOT", "--t-end", "0.05", "-s", "slider_mass"], r"PASS +slider_mass"),
        (
            ["bench", "ROBOT", "--t-end", "0.05", "--method", "dopri5", "--tolerance", "1e-6"],
            "whole: 6 states",
        ),
    ],
)
def test_commands(robot, command, said, capsys):
    assert main([robot if word == "ROBOT" else word for word in command]) == 0
    printed = capsys.readouterr()
    assert re.search(said, printed.out)
    assert "cotree: note: not read: 1 <gazebo>, 1 <material>, 1 <transmission>" in printed.err


def test_equations_and_projects(robot, tmp_path, capsys):
    assert main(["--no-mimic", "equations", robot]) == 0
    assert "theta_follow" in capsys.readouterr().out
    assert main(["generate", robot, "-o", str(tmp_path / "project")]) == 0
    assert (tmp_path / "project" / "whole.c").exists()


@pytest.mark.slow
@pytest.mark.compiler
def test_options_before_the_command_say_how_it_is_read(robot, capsys):
    run = ["run", robot, "--t-end", "0.01"]
    assert main(["--base", "free", "--no-mimic", *run]) == 0
    printed = capsys.readouterr()
    assert "base.q0" in printed.out
    assert "mimics are ignored, since mimic is False: 'follow'" in printed.err
    assert main(run) == 0  # and only for that command
    assert "base.q0" not in capsys.readouterr().out


def test_wrong_robots_and_options_are_one_sentence(robot, tmp_path, capsys):
    assert main(["--base", "flying", "graph", robot]) == 2
    assert capsys.readouterr().err == "cotree: base is 'flying': give 'fixed' or 'free'\n"
    path = tmp_path / "wrong.urdf"
    path.write_text(WHOLE.replace('value="4.0"', 'value="four"'))
    assert main(["graph", str(path)]) == 2
    said = capsys.readouterr().err
    assert re.fullmatch(r"cotree: .*wrong\.urdf:7: value of <mass> of link .* not a number\n", said)


def test_a_saved_robot_runs_and_says_the_same(robot, tmp_path, capsys):
    saved = str(tmp_path / "whole.toml")
    assert main(["--base", "free", "save", robot, "-o", saved]) == 0
    printed = capsys.readouterr()
    assert printed.out == f"wrote {saved}\n"
    assert main(["graph", saved]) == 0
    again = capsys.readouterr()
    assert again.err == printed.err
    assert re.search(r"base +ground -> base_link", again.out)
    assert main(["save", robot, "-o", str(tmp_path / "x.urdf")]) == 2
    assert "name a file that ends in .toml" in capsys.readouterr().err
