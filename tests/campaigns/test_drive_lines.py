"""Random drive lines and stacks of blocks with up to twelve elements of dry friction.

In each run the energy does not grow where nothing drives, forces keep their limits, what sticks
stays, nothing chatters, and none ends early but with a sentence that is true of it. As a campaign:
``pytest --slow --campaign tests/campaigns/test_drive_lines.py``, 10,200 runs of 340 structures.
"""

import pytest
from drive_lines import MOST_EVENTS, compare_sensitivities, run_line

#: Structures of a quick run and of slow ones, and runs of each; those of the campaign.
QUICK, SLOW, FEW = 1, 10, 10
ALL, RUNS, BLOCK = 340, 30, 10

#: The only sentence that a run may end early with: a clutch beside a gear of ratio one.
BESIDE_A_GEAR = "would stick beside a gear"


def check(tally):
    """Check what was seen over the runs of some structures."""
    for sentence, runs in tally.stops.items():
        assert BESIDE_A_GEAR in sentence, (sentence, runs)
    assert tally.most[0] < MOST_EVENTS, tally.most
    # Several changes follow each other closely where a force nearly reaches its limit, or where
    # one that sticks lets its neighbour go; 100 of them would end the run.
    assert tally.crowd[0] <= 12, tally.crowd
    # Steps have a tolerance of 1e-9; events are located to rounding, by which what sticks drifts.
    for what in ("growth", "excess", "creep", "backwards"):
        assert getattr(tally, what)[0] <= 1e-9, (what, getattr(tally, what))


@pytest.mark.compiler
@pytest.mark.parametrize(
    "seed",
    [pytest.param(i, marks=[pytest.mark.slow] if i >= QUICK else []) for i in range(SLOW)],
)
def test_random_drive_lines_stick_and_slide_as_friction_does(seed):
    check(run_line(seed, FEW))


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.compiler
@pytest.mark.parametrize("first", range(0, ALL, BLOCK))
def test_all_random_drive_lines_stick_and_slide_as_friction_does(first):
    for seed in range(first, first + BLOCK):
        check(run_line(seed, RUNS))


@pytest.mark.slow
@pytest.mark.compiler
@pytest.mark.parametrize(
    "seed", [9, *(pytest.param(seed, marks=pytest.mark.campaign) for seed in (15, 23, 24))]
)
def test_sensitivities_of_random_drive_lines_agree_with_differences(seed):
    """Of edges that stop together all have their modes at once, and nothing there only grazes."""
    worst, stops = compare_sensitivities(seed, 6)
    assert stops == []
    # Runs at 1e-11 over a step of 1e-6 leave 1e-5 of a derivative, times what the motion multiplies
    # errors by; 3.2e-5 is the most that was seen.
    assert worst <= 1e-4
