"""Links from a page to a file or folder of the checkout lead to a page that shows it: code in colours, folders as lists.

Pages stay readable where the repository is, since they name the files themselves.
"""

import ast
import html
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from pygments.lexers import guess_lexer_for_filename
from pygments.util import ClassNotFound
from sphinx import addnodes
from sphinx.application import Sphinx

TOP = Path(__file__).resolve().parents[2]
PAGES = {
    "README.md": "index",
    "CHANGELOG.md": "changelog",
    "CONTRIBUTING.md": "contributing",
    "SECURITY.md": "security",
    "benchmarks/README.md": "benchmarks",
}
"""Files outside the folder of the site that a page of it stands for."""
FOLDER = "source"


def point_to_pages(app: Sphinx, document: nodes.document) -> None:
    """Replace the links of one page, before Sphinx copies their files as downloads, or finds no page for them."""
    folder = Path(app.env.doc2path(app.env.docname)).parent
    for link in list(
        document.findall(lambda node: isinstance(node, addnodes.download_reference | addnodes.pending_xref))
    ):
        if link.get("reftype") != "myst":
            continue
        target, _, place = link["reftarget"].partition("#")
        if link.get("refdomain") == "doc":  # the name of a page, without its suffix, as Sphinx takes it
            bases, target = [Path(app.srcdir)], target + ".md"
        else:  # a page that includes one of the top folder has that one's links, too
            bases = [folder, TOP]
        path = next((base / target for base in bases if target and (base / target).exists()), None)
        name = path.resolve().relative_to(TOP).as_posix() if path else ""
        if name in PAGES:
            link["reftarget"], link["refdomain"] = PAGES[name], "doc"
            link["reftargetid"] = link.get("reftargetid") or place or None
        elif name and link.get("refdomain") != "doc":
            _shown(app).add(name)
            uri = app.builder.get_relative_uri(app.env.docname, f"{FOLDER}/{name}")
            link.replace_self(nodes.reference("", "", *link.children, internal=True, refuri=uri))


def pages(app: Sphinx) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Yield the page of each file and folder that is linked."""
    for name in sorted(_shown(app)):
        path = TOP / name
        if path.is_dir():
            body = f"<p>{_first_line(path / '__init__.py')}</p><dl>{''.join(_entries(app, name))}</dl>"
        else:
            text = path.read_text(encoding="utf-8")
            try:
                lexer = guess_lexer_for_filename(path.name, text).aliases[0]
            except ClassNotFound:
                lexer = "text"
            body = app.builder.highlighter.highlight_block(text, lexer, force=True)
        yield f"{FOLDER}/{name}", {"title": name, "body": f"<h1>{name}</h1>{body}"}, "page.html"


def _entries(app: Sphinx, folder: str) -> Iterator[str]:
    """Yield what a folder holds: its modules and packages, linked where a page of the site links them, too."""
    for path in sorted((TOP / folder).iterdir()):
        if path.name == "__init__.py" or not (path.suffix in (".py", ".sh") or (path / "__init__.py").exists()):
            continue
        name, words = f"{folder}/{path.name}", f"<code>{path.name}</code>"
        if name in _shown(app):
            words = f'<a href="{app.builder.get_relative_uri(f"{FOLDER}/{folder}", f"{FOLDER}/{name}")}">{words}</a>'
        yield f"<dt>{words}</dt><dd>{_first_line(path / '__init__.py' if path.is_dir() else path)}</dd>"


def _first_line(file: Path) -> str:
    words = ast.get_docstring(ast.parse(file.read_bytes())) if file.suffix == ".py" and file.exists() else None
    return html.escape((words or "").partition("\n")[0])


def _shown(app: Sphinx) -> set[str]:
    if not hasattr(app.env, "flatlight_sources"):
        app.env.flatlight_sources = set()
    return app.env.flatlight_sources


def setup(app: Sphinx) -> dict[str, bool]:
    """Come before Sphinx's own collectors of downloads (500)."""
    app.connect("doctree-read", point_to_pages, priority=100)
    app.connect("html-collect-pages", pages)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
