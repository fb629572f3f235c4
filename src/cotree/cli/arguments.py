"""Parsing of command-line texts, with one sentence for each refusal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.errors import ParameterError, SceneError, TopologyError, brief

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cotree.api import Scene
    from cotree.scene.graphs import TreeChoice


def given(**options: float | None) -> dict[str, float]:
    """Keep the options that were given; what the others stand for is decided elsewhere."""
    return {name: value for name, value in options.items() if value is not None}


def read_numbers(option: str, texts: Sequence[str]) -> dict[str, float]:
    """Read ``name=number`` for each time that an option is given.

    Raises
    ------
    ParameterError
        If a text has another form or a name is given twice.
    """
    numbers = {}
    for name, value in read_pairs(option, texts).items():
        try:
            numbers[name] = float(value)
        except ValueError:
            raise ParameterError(
                f"{option} {brief(name)}={brief(value)}: '{brief(value)}' is not a number; "
                f"write it as {option} {brief(name)}=1.5"
            ) from None
    return numbers


def read_pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Read ``name=text`` for each time that an option is given; see :func:`read_numbers`."""
    pairs: dict[str, str] = {}
    for text in texts:
        # Only the first sign of equality counts: expressions may hold others.
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value):
            raise ParameterError(
                f"{option} '{brief(text)}' is not of the form name=value: "
                f"write it as {option} L=1.5"
            )
        # The last of several values would win in silence.
        if name in pairs:
            raise ParameterError(f"{option} gives '{brief(name)}' twice: give it once")
        pairs[name] = value
    return pairs


def read_inputs(scene: Scene, texts: Sequence[str], values: Mapping[str, float]) -> Scene:
    """Put expressions in place of inputs; ``values`` has those of names that are new."""
    inputs = read_pairs("--input", texts)
    if not inputs:
        return scene
    # Imported here, since most commands need none of it.
    from cotree.scene.replaced import new_names

    return scene.with_inputs(
        inputs, {name: values[name] for name in new_names(scene, inputs, values)}
    )


def read_tolerances(texts: Sequence[str]) -> list[float | tuple[float, float]]:
    """Read ``rtol`` or ``rtol,atol`` for each time that the option is given.

    Raises
    ------
    ParameterError
        If a text has another form.
    """
    tolerances: list[float | tuple[float, float]] = []
    for text in texts:
        try:
            # Unpacking refuses three numbers and more by the same ValueError as a word.
            rtol, *rest = (float(part) for part in text.split(","))
            (atol,) = rest or (None,)
        except ValueError:
            raise ParameterError(
                f"--tolerance '{brief(text)}' is not of the form rtol or rtol,atol: "
                "write it as --tolerance 1e-6"
            ) from None
        tolerances.append(rtol if atol is None else (rtol, atol))
    return tolerances


def read_tree(texts: Sequence[str]) -> TreeChoice:
    """Read branches: ``j1,h2`` for both graphs, or ``translation=m rotation=s`` for each.

    Raises
    ------
    TopologyError
        If the two forms are mixed, or a domain is given twice.
    """
    # Names of edges hold no sign of equality, so that one decides on the form.
    if not any("=" in text for text in texts):
        names = [name for text in texts for name in _names(text)]
        # No option leaves the choice of the tree to cotree; an empty text names no branches.
        return names if texts else None
    tree: dict[str, list[str]] = {}
    for text in texts:
        domain, equals, names_text = text.partition("=")
        if not equals:
            raise TopologyError(
                f"--tree '{brief(text)}' names no domain, but another --tree does: "
                "write --tree translation=... --tree rotation=..."
            )
        if domain.strip() in tree:
            raise TopologyError(f"--tree gives the domain '{brief(domain)}' twice: give it once")
        tree[domain.strip()] = _names(names_text)
    return tree


def check_folder(path: Path | None) -> None:
    """Refuse a file that cannot be written because its folder does not exist.

    It is looked at before a run, so that no work is lost.

    Raises
    ------
    SceneError
        If there is no such folder, or the path is one itself.
    """
    if path is None:
        return
    if not path.parent.is_dir():
        raise SceneError(
            f"cannot write '{path}': there is no folder '{path.parent}'; make it first"
        )
    if path.is_dir():
        raise SceneError(f"cannot write '{path}': it is a folder; name a file in it")


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def check_picture(path: Path | None) -> None:
    """Refuse a picture that cannot be written, before any work is done for it.

    Raises
    ------
    SceneError
        If its folder does not exist or its suffix is unknown.
    """
    if path is None:
        return
    # Imported here, since most commands draw nothing.
    from cotree import plot

    check_folder(path)
    plot.check_picture(path)


def check_animated(path: Path | None, scene: Scene) -> bool:
    """Refuse a file of an animation that cannot be written, before any work is done for it.

    Returns
    -------
    bool
        Whether something in the scene moves in space; curves are drawn where nothing does.

    Raises
    ------
    SceneError
        If its folder does not exist, or its suffix is unknown.
    """
    if path is None:
        return False
    from cotree.watch import check_animation

    check_folder(path)
    check_animation(path)
    return bool(scene.mechanics.edges)
