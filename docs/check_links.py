"""Check every link of the built site, and of the Markdown of the repository, without a network.

``python docs/check_links.py out/docs``: links inside must lead to a file, and to an anchor that it
has; addresses elsewhere must be written as addresses are.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).resolve().parents[1]
_LINK = re.compile(
    r"(?<!!)\[(?:[^\[\]]|\[[^\]]*\])*\]\(([^()\s]+(?:\([^()]*\))?)\)|!\[[^\]]*\]\(([^)\s]+)\)"
)
_HEADING = re.compile(r"^#{1,6} +(.+?) *#*$", re.MULTILINE)
_HOST = re.compile(r"[a-z0-9-]+(\.[a-z0-9-]+)+(:\d+)?", re.IGNORECASE)


@dataclass
class Page(HTMLParser):
    """A page's links and anchors."""

    links: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take what other pages may name, and what this one names."""
        for name, value in attrs:
            if value and (name == "id" or (tag == "a" and name == "name")):
                self.anchors.add(value)
            # The theme's links to the first line of the page and to its search are empty anchors.
            elif value and name in ("href", "src") and value != "#":
                self.links.append(value)


def wrong_address(link: str) -> str:
    """Return the fault of an external address; empty if it is well formed."""
    if link.startswith(("data:", "javascript:")):
        return ""
    try:
        parts = urlsplit(link)
    except ValueError as error:
        return str(error)
    if parts.scheme == "mailto":
        return "" if "@" in parts.path else "an address of mail without '@'"
    if parts.scheme not in ("http", "https"):
        return f"the scheme '{parts.scheme}' is neither http nor https"
    return "" if _HOST.fullmatch(parts.netloc) else f"'{parts.netloc}' is no host"


def is_elsewhere(link: str) -> bool:
    """Return whether a link leaves the checked files."""
    return bool(re.match(r"[a-z][a-z0-9+.-]*:|//", link, re.IGNORECASE))


def wrong_links_of_site(site: Path) -> Iterator[str]:
    """List the links of built pages that lead nowhere."""
    pages: dict[Path, Page] = {}
    for path in sorted(site.rglob("*.html")):
        if "_static" in path.parts:  # templates of the theme
            continue
        pages[path.resolve()] = page = Page()
        page.feed(path.read_text(encoding="utf-8"))
    for path, page in pages.items():
        for link in dict.fromkeys(page.links):
            reason = _wrong_inside(path, link, pages, site.resolve())
            if reason:
                yield f"{path.relative_to(site.resolve())}: '{link}': {reason}"


def _wrong_inside(path: Path, link: str, pages: dict[Path, Page], site: Path) -> str:
    if is_elsewhere(link):
        return wrong_address(link)
    parts = urlsplit(link)
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target.is_dir():
        target /= "index.html"
    if not target.is_file() or not target.is_relative_to(site):
        return "there is no such file"
    anchor = unquote(parts.fragment)
    if anchor and target in pages and anchor not in pages[target].anchors:
        return f"that page has no anchor '{anchor}'"
    return ""


def anchors_of_markdown(text: str) -> set[str]:
    """Return the anchors that GitHub and MyST make of headings."""
    found: set[str] = set()
    for heading in _HEADING.findall(re.sub(r"```.*?```", "", text, flags=re.DOTALL)):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
        slug = re.sub(r"[^\w\- ]", "", plain).strip().replace(" ", "-")
        n = sum(1 for anchor in found if anchor == slug or re.fullmatch(rf"{slug}-\d+", anchor))
        found.add(f"{slug}-{n}" if n else slug)
    return found


def wrong_links_of_repository(root: Path) -> Iterator[str]:
    """List the links of Markdown files that lead nowhere as the repository shows them."""
    for path in (*sorted(root.glob("*.md")), *sorted(root.glob("benchmarks/*.md")), *_pages(root)):
        text = re.sub(r"```.*?```|`[^`\n]*`", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
        for link in dict.fromkeys(a or b for a, b in _LINK.findall(text)):
            reason = _wrong_in_repository(path, link)
            if reason:
                yield f"{path.relative_to(root)}: '{link}': {reason}"


def _pages(root: Path) -> list[Path]:
    # What Sphinx writes among the pages is not of the repository.
    made = {root / "docs" / name for name in ("examples", "reference")}
    found = sorted((root / "docs").rglob("*.md"))
    return [path for path in found if not made & set(path.parents)]


def _wrong_in_repository(path: Path, link: str) -> str:
    if is_elsewhere(link):
        return wrong_address(link)
    parts = urlsplit(link)
    target = path.parent / unquote(parts.path) if parts.path else path
    # The pictures and pages of the gallery are there once the site is built.
    if "examples/" in parts.path or "reference/" in parts.path or target.suffix == ".rst":
        return ""
    if not target.exists():
        return "there is no such file"
    if parts.fragment and target.suffix == ".md":
        known = anchors_of_markdown(target.read_text(encoding="utf-8"))
        if unquote(parts.fragment) not in known:
            return f"'{target.name}' has no heading for '{parts.fragment}'"
    return ""


def main() -> int:
    """Print what is wrong; 1 where anything is."""
    wrong = list(wrong_links_of_repository(ROOT))
    for folder in sys.argv[1:]:
        wrong += wrong_links_of_site(Path(folder))
    print("\n".join(wrong) or "all links lead somewhere")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
