"""The drawing of the rooms, docs/pictures/rooms.svg, made from the imports in the code: ``python docs/tools/rooms.py`` writes it.

Only the standard library is needed. ``tests/docs/test_docs.py`` says when the file is not what the imports are.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from pathlib import Path

__all__ = ["FILE", "ROOMS", "drawing", "imports"]

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / "docs" / "pictures" / "rooms.svg"
ROOMS = {  # from the highest to the lowest, with what is in each
    "benchmark": "runs, cache, tables, command line, challenge, planning",
    "diagnosis": "which physics a recording shows and a twin lacks",
    "methods": "how twins are fitted, and what they look like",
    "metrics": "one number and its meaning each",
    "physics": "the simulator: terms, stepping, gradients",
    "datasets": "what a recording is; readers, checker, cameras, challenge sets",
}
WIDTH, BOX, LEFT, STEP, HEIGHT, LANE = 900, 420, 240, 92, 56, 34  # pixels
COLOURS = dict(zip(ROOMS, ("#1f77b4", "#9467bd", "#2ca02c", "#d62728", "#e07b00", "#555555"), strict=True))


def imports(root: Path = ROOT) -> set[tuple[str, str]]:
    """(room, room that it imports from), of relative imports anywhere in the code, inside functions too."""
    found = set()
    for room in ROOMS:
        for file in (root / room).rglob("*.py"):
            package = file.relative_to(root).parent.parts
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.level > len(package):  # it leaves the room
                    named = [node.module] if node.module else [alias.name for alias in node.names]
                    found |= {(room, name.split(".")[0]) for name in named if name.split(".")[0] in ROOMS}
    return {(above, below) for above, below in found if above != below}


def drawing(edges: Iterable[tuple[str, str]]) -> str:
    """An SVG of the rooms, one above the other, with an arrow from each to every room that it imports."""
    order, edges = list(ROOMS), sorted(edges, key=lambda edge: [list(ROOMS).index(room) for room in edge])
    top = {room: 20 + STEP * i for i, room in enumerate(order)}
    height = 20 + STEP * len(order)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="sans-serif">',
        "<title>Which room imports which</title>",
        f'<rect width="{WIDTH}" height="{height}" fill="white"/>',
    ]
    for room, colour in COLOURS.items():
        shape = f'<path d="M0 0L8 4L0 8z" fill="{colour}"/>'
        parts.append(f'<marker id="{room}" markerWidth="8" markerHeight="8" refX="8" refY="4" orient="auto">{shape}</marker>')
    out, into, lanes = dict.fromkeys(order, 0), dict.fromkeys(order, 0), {-1: 0, 1: 0}
    for above, below in edges:
        style = f'fill="none" stroke="{COLOURS[above]}" stroke-width="1.6" marker-end="url(#{above})"'
        if order.index(below) - order.index(above) == 1:
            x = LEFT + BOX / 2
            path = f"M{x:g} {top[above] + HEIGHT}V{top[below]}"
        else:  # around the rooms between, on the left from the highest room, else on the right
            side = -1 if above == order[0] else 1
            lanes[side] += 1
            edge = LEFT if side < 0 else LEFT + BOX
            start, end = top[above] + 10 + 9 * out[above], top[below] + 10 + 9 * into[below]
            path = f"M{edge} {start}H{edge + side * LANE * lanes[side]}V{end}H{edge}"
            out[above] += 1
            into[below] += 1
        parts.append(f'<path d="{path}" {style}/>')
    for room, says in ROOMS.items():
        y = top[room]
        parts += [
            f'<rect x="{LEFT}" y="{y}" width="{BOX}" height="{HEIGHT}" rx="6" fill="#f7f7f7" stroke="{COLOURS[room]}" stroke-width="1.6"/>',
            f'<text x="{LEFT + 16}" y="{y + 24}" font-size="17" font-weight="bold">{room}/</text>',
            f'<text x="{LEFT + 16}" y="{y + 44}" font-size="13" fill="#444444">{says}</text>',
        ]
    return "\n".join([*parts, "</svg>", ""])


if __name__ == "__main__":
    FILE.parent.mkdir(parents=True, exist_ok=True)
    FILE.write_text(drawing(imports()), encoding="utf-8")
    print(f"{FILE}: " + ", ".join(f"{above} > {below}" for above, below in sorted(imports())))
