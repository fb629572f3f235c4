"""Parsing of XML to a tree with line numbers (Expat), for untrusted files.

Document type declarations, which define entities, are rejected; depths and sizes are limited.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.parsers import expat

from cotree.readers.names import SourceLine

_MOST_ELEMENTS = 200_000
_DEEPEST = 60
_LONGEST_VALUE = 10_000  # maximum number of characters of an attribute


@dataclass
class Element:
    """An element of an XML file."""

    tag: str  # name as written, with its prefix
    attributes: dict[str, str]
    at: SourceLine  # file and first line of the element
    #: Child elements, without the text between them.
    children: list[Element] = field(default_factory=list)

    def all(self, tag: str) -> list[Element]:
        """Return all children with a tag."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> Element | None:
        """Return the first child with a tag, or None."""
        return next((child for child in self.children if child.tag == tag), None)


class _Builder:
    def __init__(self, where: str, deepest: int, most: int) -> None:
        # The text is already decoded, so the encoding in its first line is ignored.
        self.parser = expat.ParserCreate("utf-8")
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        # Without document types, a file cannot define entities, which might access other files.
        self.parser.StartDoctypeDeclHandler = self.refuse_doctype
        self.file = where
        self.root: Element | None = None
        self.open: list[Element] = []
        self.n_elements = 0
        self.deepest, self.most = deepest, most

    @property
    def at(self) -> SourceLine:
        return SourceLine(self.file, self.parser.CurrentLineNumber)

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.n_elements += 1
        if self.n_elements > self.most:
            raise self.at.error(f"more than {self.most} elements")
        if len(self.open) >= self.deepest:
            raise self.at.error(f"elements are nested more than {self.deepest} deep")
        if any(len(value) > _LONGEST_VALUE for value in attributes.values()):
            raise self.at.error(f"an attribute has more than {_LONGEST_VALUE} characters")
        element = Element(tag, attributes, self.at)
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)

    def end(self, _: str) -> None:
        self.open.pop()

    def refuse_doctype(self, *_: object) -> None:
        raise self.at.error(
            "a document type declaration, which may reach outside the file, is not read: delete it"
        )


def parse_xml(
    text: str, where: str, *, deepest: int = _DEEPEST, most: int = _MOST_ELEMENTS
) -> Element:
    """Parse an XML text of limited depth and size, without document type declarations."""
    builder = _Builder(where, deepest, most)
    try:
        builder.parser.Parse(text.encode("utf-8", "surrogatepass"), True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise SourceLine(where, error.lineno).error(f"not valid XML: {reason}") from None
    assert builder.root is not None  # expat rejects texts without an element
    return builder.root
