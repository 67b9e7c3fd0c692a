"""When the site is built, every link in it is followed: to its file and place, or as far as its syntax goes.

Nothing that a page shows may come from the network, and no external link is followed: both work without one.
"""

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.application import Sphinx
from sphinx.util import logging

LOGGER = logging.getLogger(__name__)
LOADED = {("script", "src"), ("img", "src"), ("link", "href"), ("source", "src"), ("iframe", "src")}


class Page(HTMLParser):
    """The places of a page, its links, and what it loads."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.places: set[str] = set()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what one tag tells."""
        for name, value in attrs:
            if name == "id" and value:
                self.places.add(value)
            elif (tag, name) in LOADED and value:
                self.loaded.add(value)
            elif (tag, name) == ("a", "href") and value:
                self.links.add(value)


def check(app: Sphinx, failed: Exception | None) -> None:
    """Warn of each link that leads nowhere, so that ``-W`` fails."""
    if failed or app.builder.format != "html":
        return
    top = Path(app.outdir)
    pages = {path.resolve(): Page(path) for path in top.rglob("*.html")}
    for path, page in sorted(pages.items()):
        for link in sorted(page.links | page.loaded):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                fine = link not in page.loaded and re.fullmatch(r"https?://[\w.-]+\.\w+(/\S*)?|mailto:\S+@\S+", link)
            else:
                target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
                there = pages.get(target)
                place = unquote(parts.fragment)
                fine = target.exists() and (not place or there is None or place in there.places)
            if not fine:
                LOGGER.warning(
                    "%s: a link that leads nowhere, or loads from the network: %s", path.relative_to(top), link
                )


def setup(app: Sphinx) -> dict[str, bool]:
    """Check what was built."""
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
