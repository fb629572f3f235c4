"""Optional contents of an FMU: expected results, and an icon."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import numpy.typing as npt
    from matplotlib.figure import Figure

_REFERENCES = "extra/org.fmi-standard.fmi-ls-ref"

_ICON = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}


def reference_times(t_end: float, interval: float) -> npt.NDArray[np.float64]:
    """List the communication points of the default experiment."""
    n = max(1, round(t_end / interval))
    return np.linspace(0.0, t_end, n + 1)


def reference_files(
    identifier: str,
    times: Iterable[float],
    columns: Mapping[str, Iterable[float]],
) -> dict[str, bytes]:
    """Write expected results as the layered standard LS-REF has them.

    Parameters
    ----------
    identifier : str
        The model's identifier.
    times : iterable of float
        Times, [s].
    columns : mapping of str to iterable of float
        Values by name of variable.

    Returns
    -------
    dict of str to bytes
        Two files by name.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["time", *columns])
    for row in zip(times, *columns.values(), strict=True):
        table.writerow([repr(float(value)) for value in row])
    # The namespace of attributes is that of manifests of layered standards.
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
    ElementTree.SubElement(
        root,
        "Related",
        type="text/csv",
        source=name,
        role="result",
        description="Output of the default experiment",
    )
    ElementTree.indent(root)
    manifest = f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, "unicode")}\n'
    return {
        f"{_REFERENCES}/{name}": text.getvalue().encode(),
        f"{_REFERENCES}/fmi-ls-manifest.xml": manifest.encode(),
    }


def icon_files(figure: Figure, version: int) -> dict[str, bytes]:
    """Write an icon where importers look for it.

    Parameters
    ----------
    figure : Figure
        The drawing.
    version : int
        2 or 3.
    """
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=100, metadata={"Software": None})
    if version == 2:
        return {"model.png": data.getvalue()}
    root = ElementTree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    own = ElementTree.SubElement(root, "GraphicalRepresentation")
    ElementTree.SubElement(own, "CoordinateSystem", _ICON, suggestedScalingFactorTo_mm="0.1")
    ElementTree.SubElement(own, "Icon", _ICON)
    ElementTree.indent(root)
    text = f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, "unicode")}\n'
    return {
        "terminalsAndIcons/icon.png": data.getvalue(),
        "terminalsAndIcons/terminalsAndIcons.xml": text.encode(),
    }
