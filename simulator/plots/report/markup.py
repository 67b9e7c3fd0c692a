"""The few pieces of HTML that all sections share; whatever is not marked as HTML is escaped."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


class Html(str):
    """Text that is HTML already; `shown` escapes every other one."""


def shown(value: object) -> Html:
    """Return a value as HTML.

    Example:
        >>> shown("a < b"), shown(Html("<b>"))
        ('a &lt; b', '<b>')
    """
    return value if isinstance(value, Html) else Html(escape(str(value)))


def joined(parts: Iterable[object]) -> Html:
    """Return parts one after the other."""
    return Html("".join(map(shown, parts)))


def section(name: str, title: str, *parts: object) -> Html:
    """Return a section with its heading; ``name`` is its place in the page's address."""
    head = f'<section id="{name}" aria-labelledby="{name}-title"><h2 id="{name}-title">{shown(title)}</h2>'
    return Html(f"{head}{joined(parts)}</section>\n")


def paragraph(words: object, kind: str = "") -> Html:
    """Return a paragraph; ``kind`` is its class."""
    return Html(f'<p class="{kind}">{shown(words)}</p>' if kind else f"<p>{shown(words)}</p>")


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[object]]) -> Html:
    """Return a table that can be scrolled where it is too wide; the first cell of a row names it."""
    columns = joined(Html(f'<th scope="col">{shown(head)}</th>') for head in heads)
    body = joined(
        Html(f'<tr><th scope="row">{shown(first)}</th>{joined(Html(f"<td>{shown(cell)}</td>") for cell in cells)}</tr>')
        for first, *cells in rows
    )
    return Html(
        f'<div class="wide" role="region" aria-label="{shown(caption)}" tabindex="0"><table>'
        f"<caption>{shown(caption)}</caption><thead><tr>{columns}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def facts(pairs: Iterable[tuple[object, object]]) -> Html:
    """Return (what, value) pairs as a list of descriptions."""
    items = joined(Html(f"<div><dt>{shown(what)}</dt><dd>{shown(value)}</dd></div>") for what, value in pairs)
    return Html(f'<dl class="facts">{items}</dl>')


def folded(summary: object, *parts: object) -> Html:
    """Return parts that are shown on request."""
    return Html(f"<details><summary>{shown(summary)}</summary>{joined(parts)}</details>")


def bar(shares: Iterable[float]) -> Html:
    """Return a bar of one or more parts, each a share of its whole width; what it says stands beside it in words."""
    parts, left = [], 0.0
    for number, share in enumerate(shares):
        width = 100 * min(max(share, 0.0), 1.0)
        parts.append(f'<rect class="part{number % 6}" x="{left:.2f}" width="{width:.2f}" height="8"/>')
        left += width
    return Html(
        f'<svg class="bar" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true">{"".join(parts)}</svg>'
    )


def embedded_json(value: Any) -> Html:
    r"""Return a value as JSON that can stand in a script element: nothing in it ends the element.

    Example:
        >>> print(embedded_json(["</script>"]))
        ["\u003c/script\u003e"]
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return Html(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))
