"""The error budget as a picture: by part of the motion, how far the twin is off and what that is made of."""

from __future__ import annotations

from html import escape

from .tables import Html

__all__ = ["LAYERS", "budget", "shares"]

LAYERS = {
    "noise": "noise of the tracks",
    "representation": "what sound twins are off by (cells, shape, hands)",
    "parameters": "what the fit leaves open",
    "named": "what was named",
    "unexplained": "unexplained",
}
WIDTH, HEIGHT, LEFT, ABOVE, BELOW, GAP = 720, 200, 34, 24, 34, 0.18


def shares(part: dict) -> dict[str, float]:
    """Of one part of the motion, the share of the squared error that each layer takes, in their order, as far as there is error left.

    Layers are RMS in mm, whose squares add; what sound twins are off by on average may be more than this one is.
    """
    whole = float(part.get("error") or 0.0) ** 2
    left, found = whole, {}
    for name in LAYERS:
        taken = left if name == "unexplained" else min(left, float(part.get(name) or 0.0) ** 2)
        found[name] = taken / whole if whole > 0 else 0.0
        left -= taken
    return found


def budget(result: dict) -> Html:
    """A section with one picture for each recording, or nothing where there is no budget."""
    parts = result.get("budget") or []
    if not parts:
        return Html()
    records = list(dict.fromkeys(part["record"] for part in parts))
    most = max(float(part["error"]) for part in parts) or 1.0
    pictures = "".join(_picture([p for p in parts if p["record"] == r], most) for r in records)
    key = "".join(f'<span class="layer"><i class="{name}"></i>{escape(words)}</span>' for name, words in LAYERS.items())
    said = (
        "The height of a bar is how far the twin is off in that part of the motion (root mean square over regions of the body). Squares "
        "add: each layer takes its share of them, in this order, and what is left is unexplained. Frames in paler bars were not fitted."
    )
    return Html(
        '<section id="budget" aria-labelledby="budget-title"><h2 id="budget-title">How far off, and what of</h2>'
        f'<p>{said}</p><p class="layers">{key}</p>{pictures}</section>'
    )


def _picture(parts: list[dict], most: float) -> str:
    end = max(float(p["end"]) for p in parts) or 1.0
    across, up = (WIDTH - LEFT - 8) / end, (HEIGHT - BELOW - ABOVE) / most
    floor = HEIGHT - BELOW
    drawn = [f'<line class="axis" x1="{LEFT}" x2="{WIDTH - 8}" y1="{floor}" y2="{floor}"/>']
    for size in _ticks(most):
        y = floor - size * up
        drawn.append(f'<line class="tick" x1="{LEFT}" x2="{WIDTH - 8}" y1="{y:.1f}" y2="{y:.1f}"/>')
        drawn.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{size:g}</text>')
    for part in parts:
        begin, last, error = float(part["begin"]), float(part["end"]), float(part["error"])
        x, width, y = LEFT + across * begin, across * (last - begin) * (1 - GAP), float(floor)
        inside = ""
        for name, share in shares(part).items():
            if share > 0:
                y -= share * error * up
                inside += f'<rect class="{name}" x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{share * error * up:.1f}"/>'
        words = ", ".join(f"{words} {share:.0%}" for words, share in zip(LAYERS.values(), shares(part).values(), strict=True) if share > 0)
        title = f"{begin:.2f} to {last:.2f} s: {error:.1f} mm off; of the squares {words}"
        drawn.append(f'<g class="{"fitted" if part["fitted"] else "held"}"><title>{escape(title)}</title>{inside}</g>')
        drawn.append(f'<text x="{x + width / 2:.1f}" y="{floor + 15}" text-anchor="middle">{(begin + last) / 2:.1f}</text>')
    drawn.append(f'<text x="{WIDTH - 8}" y="{HEIGHT - 3}" text-anchor="end">time [s]</text><text x="{LEFT}" y="12">error [mm]</text>')
    name = escape(str(parts[0].get("recording", "")))
    return (
        f'<figure class="budget"><figcaption>{name}</figcaption><svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="Error by part of the motion in {name}">{"".join(drawn)}</svg></figure>'
    )


def _ticks(most: float) -> list[float]:
    """Two to five round numbers up to ``most``."""
    from math import floor, log10

    step = 10 ** floor(log10(most))
    while most / step < 2:
        step /= 2
    while most / step > 5:
        step *= 2
    return [step * k for k in range(1, int(most / step + 1e-9) + 1)]
