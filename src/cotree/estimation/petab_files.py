"""The YAML file of a PEtab problem, version 1: it names the tables and the model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cotree.errors import Error, SceneError, brief
from cotree.estimation.petab_tables import Tables, fill_tables
from cotree.files import read_text
from cotree.readers.source_line import LARGEST_FILE

_MISSING = "reading PEtab problems needs PyYAML: run `pip install 'cotree[petab]'`"


def read_tables(path: str | Path) -> Tables:
    """Read the tables that a YAML file names.

    Parameters
    ----------
    path : str or Path
        The YAML file; paths in it are relative to its folder.

    Raises
    ------
    SceneError
        If a file is missing or cannot be read, has another version, or a row is invalid.
    Error
        If the extra ``petab`` is not installed.
    """
    data, folder = _parsed(path), Path(path).parent
    version = str(_version(data)).strip()
    if version.split(".")[0] != "1":
        raise SceneError(
            f"{path}: format_version is {brief(version)}, but only version 1 of PEtab is supported"
        )
    problems = data.get("problems")
    if not isinstance(problems, list) or len(problems) != 1 or not isinstance(problems[0], dict):
        raise SceneError(f"{path}: 'problems' must list one problem: write a file for each")
    problem = problems[0]
    files = {
        kind: [_existing(path, folder, name) for name in _listed(path, problem, f"{kind}_files")]
        for kind in ("observable", "condition", "measurement")
    }
    files["parameter"] = [
        _existing(path, folder, name) for name in _listed(path, data, "parameter_file")
    ]
    if problem.get("mapping_files"):
        raise SceneError(
            f"{path}: mapping_files are not supported: use names of the model in the tables"
        )
    model = _existing(path, folder, _model(path, problem))
    tables = Tables(str(path), model, tuple(files["measurement"]))
    fill_tables(tables, files)
    return tables


def _parsed(path: str | Path) -> dict[str, Any]:
    try:
        import yaml
    except ImportError:
        raise Error(_MISSING) from None
    text = read_text(path, LARGEST_FILE)
    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        raise SceneError(f"{where}: not valid YAML: {getattr(error, 'problem', '')}") from None
    if not isinstance(data, dict) or "format_version" not in data:
        raise SceneError(f"{path}: not a PEtab problem: it has no 'format_version'")
    return data


def _version(data: dict[str, Any]) -> object:
    given = data["format_version"]
    return given.get("version") if isinstance(given, dict) else given


def _listed(path: str | Path, data: dict[str, Any], key: str) -> list[str]:
    given = data.get(key)
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise SceneError(f"{path}: '{key}' must name at least one file")
    return names


def _model(path: str | Path, problem: dict[str, Any]) -> str:
    """Find the model: ``sbml_files``, or ``model_files`` in later forms of version 1."""
    models = problem.get("model_files")
    if isinstance(models, dict) and not problem.get("sbml_files"):
        for model in models.values():
            language = model.get("language") if isinstance(model, dict) else None
            if language != "sbml":
                raise SceneError(
                    f"{path}: the model is in '{language}', but only SBML is supported"
                )
        names = [str(model.get("location")) for model in models.values()]
    else:
        names = _listed(path, problem, "sbml_files")
    if len(names) != 1:
        raise SceneError(f"{path}: {len(names)} models are given, but only one is supported")
    return names[0]


def _existing(path: str | Path, folder: Path, name: str) -> Path:
    found = folder / name
    try:
        is_file = found.is_file()
    except OSError:  # the name is too long for the file system
        is_file = False
    if not is_file:
        raise SceneError(f"{path}: the file '{brief(name)}' does not exist in '{folder}'")
    return found
