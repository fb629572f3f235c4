"""Single slips in every shipped scene, and in the examples of components: each is answered.

A scene with a slip is refused with one sentence that names the culprit (the edge, node, field,
value or line) or still means something. Nothing else may come out, nor take long. As a campaign:
``pytest --slow --campaign tests/campaigns/test_typos.py``; with ``-rP`` fifty answers are printed
for a person to judge their advice, from the seed in ``COTREE_SEED``.
"""

from __future__ import annotations

import os
import random
import re
import time
import warnings
from pathlib import Path

import pytest
from evaluated_kernels import EvaluatedKernels
from typos import Typo, typo

import cotree
from cotree import Scene, spec
from cotree.model import loading
from cotree.model.model import CompiledModel
from cotree.scene.toml_file import read_scene, shipped_scenes

ROOT = Path(__file__).parents[2]
SEED = int(os.environ.get("COTREE_SEED", "0"))
LONGEST, LONGEST_TIME = 1500, 5.0  # characters, those of all types; seconds of the processor


def sources() -> tuple[dict[str, str], dict[str, str]]:
    """Return the files of shipped scenes, and the examples of the components' pages."""
    scenes = ROOT / "src" / "cotree" / "scenes"
    shipped = {name: (scenes / f"{name}.toml").read_text() for name in shipped_scenes()}
    pages = sorted((ROOT / "docs" / "components").glob("[a-z]*.md"))
    found = {page.stem: re.search(r"```toml\n(.*?)```", page.read_text(), re.S) for page in pages}
    return shipped, {name: match[1] for name, match in found.items() if match}


SHIPPED, EXAMPLES = sources()


def drawn(seed: int) -> tuple[str, Typo]:
    """Draw a scene, two of three times a shipped one, and a slip in it."""
    rng = random.Random(seed)
    pool = SHIPPED if rng.random() < 0.65 else EXAMPLES
    name = rng.choice(sorted(pool))
    return name, typo(pool[name], rng)


def answer(text: str) -> str:
    """Return the message that refuses a scene; empty if it is accepted."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            read_scene(text, "scene.toml", Scene).compile().start()
        except cotree.Error as error:
            return str(error)
    return ""


def is_named(slip: Typo, said: str) -> bool:
    """Return whether a sentence names a word of the line, its table, or the line or the next."""
    words = (re.escape(word) for word in slip.words | slip.below)
    lines = (rf"line {n}" for n in (slip.line, slip.line + 1))
    return any(re.search(rf"(?<!\w){word}(?!\w)", said) for word in (*words, *lines))


def load_evaluated(text, options, at_rest=None) -> CompiledModel:
    """Load a model without compiling it, which would take most of the time."""
    model = CompiledModel(text, EvaluatedKernels(text.program), options)
    model.rest = None if at_rest is None else loading.OperatingPoint(model, at_rest)
    return model


def check(seeds: range, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loading, "load_model", load_evaluated)
    monkeypatch.setattr(spec, "load_model", load_evaluated)
    told, unnamed = [], []
    for seed in seeds:
        name, slip = drawn(seed)
        began = time.process_time()
        said = answer(slip.text)
        where = f"seed {seed}: {name}: {slip.section} {slip.before!r} -> {slip.after!r}\n  {said}"
        assert time.process_time() - began < LONGEST_TIME, where
        assert "\n" not in said, where
        assert len(said) < LONGEST, where
        if said:
            told.append(where)
            unnamed += [] if is_named(slip, said) else [where]
    assert len(told) > 0.5 * len(seeds)  # or slips would go unnoticed
    # Of a singular matrix the joint is named whose motion is free; the slip was in its body.
    assert len(unnamed) <= 0.005 * len(seeds), unnamed
    print(*random.Random(SEED).sample(told, min(50, len(told))), sep="\n")


def test_a_slip_is_answered_with_its_culprit(monkeypatch):
    check(range(SEED, SEED + 60), monkeypatch)


@pytest.mark.slow
def test_more_slips(monkeypatch):
    check(range(SEED + 100, SEED + 400), monkeypatch)


@pytest.mark.slow
@pytest.mark.campaign
def test_a_campaign_of_slips(monkeypatch):
    check(range(SEED + 1000, SEED + 3000), monkeypatch)
