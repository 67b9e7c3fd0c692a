"""Flowcharts of Mermaid's syntax (``a["label"] --> b``), drawn as SVG when the site is built: no script, no network.

What a box points to lies below it. An edge that passes layers has a place of its own in each of them, so that it goes
between their boxes (Sugiyama et al., IEEE Trans. Syst. Man Cybern. 11, 109, 1981).
"""

import html
import re
import textwrap
from dataclasses import dataclass, field
from itertools import pairwise

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

CHARACTER, LINE, PADDING = 7.9, 17, 12
GAP, LAYER, LETTERS = 20, 84, 36
BOX = re.compile(r'(\w+)(?:\["([^"]+)"\])?')


@dataclass(eq=False)
class Node:
    """A box, or the place of an edge that passes a layer (without words)."""

    words: list[str] = field(default_factory=list)
    layer: int = 0
    x: float = 0.0
    y: float = 0.0
    above: list["Node"] = field(default_factory=list)
    below: list["Node"] = field(default_factory=list)

    @property
    def width(self) -> float:
        """Of the box."""
        return CHARACTER * max(map(len, self.words)) + 2 * PADDING if self.words else 2.0

    @property
    def height(self) -> float:
        """Of the box."""
        return LINE * len(self.words) + PADDING if self.words else 0.0


def parse(text: str) -> tuple[list[Node], list[tuple[Node, Node]]]:
    """Return the boxes and the edges of a flowchart.

    Raises:
        ValueError: a line that is neither the head nor an edge.
    """
    head, *lines = text.strip().splitlines()
    if not head.startswith("flowchart"):
        raise ValueError(f"{head!r}: only flowcharts are drawn")
    boxes: dict[str, Node] = {}
    edges = []
    for line in lines:
        ends = [BOX.fullmatch(end.strip()) for end in line.split("-->")]
        if len(ends) != 2 or None in ends:
            raise ValueError(f"{line!r}: expected an edge, such as a --> b")
        for name, label in (end.groups() for end in ends if end):
            box = boxes.setdefault(name, Node([name]))
            box.words = textwrap.wrap(label, LETTERS) if label else box.words
        edges.append(tuple(boxes[end[1]] for end in ends if end))
    return list(boxes.values()), edges


def layers(boxes: list[Node], edges: list[tuple[Node, Node]]) -> list[list[Node]]:
    """Return the boxes from top to bottom and from left to right, with the places of edges among them."""
    for _ in boxes:
        for upper, lower in edges:
            upper.layer = max(upper.layer, lower.layer + 1)
    rows = [[box for box in boxes if box.layer == layer] for layer in range(max(box.layer for box in boxes), -1, -1)]
    for upper, lower in edges:
        path = [upper, *(Node(layer=layer) for layer in range(upper.layer - 1, lower.layer, -1)), lower]
        for place in path[1:-1]:
            rows[-1 - place.layer].append(place)
        for one, next_one in pairwise(path):
            one.below.append(next_one)
            next_one.above.append(one)
    for _ in range(12):
        for side, order in (("above", rows), ("below", rows[::-1])):
            for row in order:
                for i, node in enumerate(row):
                    near = getattr(node, side)
                    node.x = sum(other.x for other in near) / len(near) if near else i / len(row)
                row.sort(key=lambda node: node.x)
                for i, node in enumerate(row):
                    node.x = (i + 0.5) / len(row)
    return rows


def place(rows: list[list[Node]]) -> tuple[float, float]:
    """Set where each node is, near to what it is joined with; return the drawing's width and height."""
    for level, row in enumerate(rows):
        left = 0.0
        for node in row:
            node.x, node.y = left + node.width / 2, level * LAYER + LAYER / 2
            left += node.width + GAP
    for _ in range(60):
        for row in rows:
            for node in row:
                near = node.above + node.below
                node.x = sum(other.x for other in near) / len(near)
            apart = [(a.width + b.width) / 2 + GAP for a, b in pairwise(row)]
            right, left = [node.x for node in row], [node.x for node in row]
            for i, least in enumerate(apart):
                right[i + 1] = max(right[i + 1], right[i] + least)
            for i in range(len(apart) - 1, -1, -1):
                left[i] = min(left[i], left[i + 1] - apart[i])
            for node, one, other in zip(row, left, right, strict=True):
                node.x = (one + other) / 2
    nodes_ = [node for row in rows for node in row]
    first = min(node.x - node.width / 2 for node in nodes_) - 2
    for node in nodes_:
        node.x -= first
    return max(node.x + node.width / 2 for node in nodes_) + 2, len(rows) * LAYER


def draw(text: str) -> str:
    """Return a flowchart as SVG.

    Raises:
        ValueError: as `parse`.
    """
    boxes, edges = parse(text)
    rows = layers(boxes, edges)
    width, height = place(rows)
    parts = [
        f'<svg viewBox="0 0 {width:.0f} {height:.0f}" role="img" xmlns="http://www.w3.org/2000/svg"><defs>'
        '<marker id="arrow" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0L8 4L0 8z"/></marker></defs>'
    ]
    for box in boxes:
        for end in box.below:
            way = [(box.x, box.y + box.height / 2)]
            while not end.words:
                way.append((end.x, end.y))
                (end,) = end.below
            way.append((end.x, end.y - end.height / 2))
            curve = f"M{way[0][0]:.1f} {way[0][1]:.1f}"
            for (x0, y0), (x1, y1) in pairwise(way):
                middle = (y0 + y1) / 2
                curve += f"C{x0:.1f} {middle:.1f} {x1:.1f} {middle:.1f} {x1:.1f} {y1:.1f}"
            parts.append(f'<path d="{curve}" marker-end="url(#arrow)"/>')
    for box in boxes:
        x, y = box.x - box.width / 2, box.y - box.height / 2
        parts.append(f'<rect x="{x:.1f}" y="{y:.1f}" width="{box.width:.1f}" height="{box.height:.1f}" rx="5"/>')
        for i, words in enumerate(box.words):
            parts.append(f'<text x="{box.x:.1f}" y="{y + LINE * (i + 1):.1f}">{html.escape(words)}</text>')
    return "".join([*parts, "</svg>"])


class Flowchart(Directive):
    """What a fence ```` ```mermaid ```` holds, as a drawing."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Draw the flowchart."""
        try:
            drawing = draw("\n".join(self.content))
        except ValueError as error:
            raise self.error(str(error)) from error
        return [nodes.raw("", f'<div class="flowchart">{drawing}</div>', format="html")]


def setup(app: Sphinx) -> dict[str, bool]:
    """Take over the fences that code hosts draw themselves."""
    app.add_directive("mermaid", Flowchart)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
