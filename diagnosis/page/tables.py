"""The page's text: facts and tables as HTML. Everything that comes from outside is escaped."""

from __future__ import annotations

from html import escape

from .words import EFFECTS, effect_name, extent, less, millimetres, number, place, window

__all__ = ["Html", "clusters", "detectable", "facts", "fit", "hypotheses", "notes"]

SPLITS = {"train": "training frames", "heldout": "held-out frames", "transfer": "another interaction, never fitted"}
LIKELY, FAINT = 4, 0.05  # readings that are said at most, and the least probability of one that is
YARDSTICKS = ("last_residual", "learned_residual")


class Html(str):
    """Text that is HTML already; any other text is escaped on its way into a cell."""


def facts(result: dict) -> Html:
    """Effect, place, time, parameters and runners-up: what the headline is short for."""
    rows = []
    if result.get("effect"):
        rows.append(("what", _effect(result["effect"])))
    alternatives, chances = result.get("alternatives") or [], result.get("probabilities") or {}
    if alternatives:
        said = [Html(f"{_effect(name)}{_chance(chances.get(name))}") for name in alternatives]
        rows.append(("other readings", Html("<br>".join(said))))
    if result.get("verdict") not in ("adequate", "cannot_tell") and (likely := _likely(chances)):
        rows.append(("how likely", likely))
    if test := result.get("test"):
        rows.append(("chance of a sound twin", f"p = {number(test.get('p'))} (alarm below {number(test.get('level'))})"))
    if result.get("where") or result.get("when"):
        rows += [("where", place(result.get("where"))), ("when", window(result.get("when")))]
    for name, one in (result.get("parameters") or {}).items():
        value = number(one.get("value"), one.get("unit"))
        interval = one.get("interval90")
        if interval:
            low, high = (number(end) for end in interval)
            value += f" (90 % interval: {'up to ' if interval[0] is None else f'{low} to '}{high})"
        rows.append((name.replace("_", " "), value))
    return Html("<dl>" + "".join(f"<div><dt>{_cell(a)}</dt><dd>{_cell(b)}</dd></div>" for a, b in rows) + "</dl>") if rows else Html()


def hypotheses(result: dict) -> Html:
    """Every explanation that was tried, with what it gained and why it was not chosen."""
    rows = []
    for one in (result.get("evidence") or {}).get("hypotheses") or []:
        name = one.get("effect")
        kind = "yardstick" if name in YARDSTICKS else one.get("kind", "")
        gains = [Html(_bar(one.get(f"{split}_gain"))) for split in ("train", "heldout", "transfer")]
        amplitude = number(one.get("amplitude"), one.get("unit"))
        absorbed = "-" if one.get("absorbed") is None else f"{one['absorbed']:.0%}"
        chance = "-" if one.get("probability") is None else f"{one['probability']:.0%}"
        style = "chosen" if name and name == result.get("effect") else "aside" if kind in ("yardstick", "baseline") else ""
        rows.append((style, [_effect(name), kind, *gains, absorbed, amplitude, chance, one.get("why") or ""]))
    gains = ("train gain", "held-out gain", "transfer gain")
    header = ("effect", "kind", *gains, "absorbed", "amplitude", "probability", "what speaks for or against it")
    return _table(header, rows, "No explanation was tried.")


def fit(result: dict) -> Html:
    """Mean error before and after, beside the noise floor and the yardsticks."""
    names = ("baseline", "extended", "noise_floor", "last_residual", "learned_residual")
    rows = []
    for split, words in SPLITS.items():
        one = (result.get("fit") or {}).get(split)
        if not one or all(one.get(name) is None for name in names):
            continue
        before, floor, after = one.get("baseline"), one.get("noise_floor"), one.get("extended")
        cells = []
        for name in names:
            change = None if name in ("baseline", "noise_floor") else less(before, one.get(name))
            cells.append(Html(_cell(millimetres(one.get(name))) + (f"<small>{change}</small>" if change else "")))
        closable = None not in (before, floor, after) and before > floor
        cells.append(f"{(before - after) / (before - floor):.0%}" if closable else "-")
        rows.append(("", [words, *cells]))
    header = ("mean error on", "baseline", "extended", "noise floor", "last residual", "learned residual", "closable error removed")
    return _table(header, rows, "No error was measured.")


def clusters(result: dict) -> Html:
    """Where and when the twin is off by more than chance, strongest first; a button shows each in the view."""
    rows = []
    for index, one in enumerate((result.get("evidence") or {}).get("clusters") or []):
        button = Html(f'<button type="button" data-cluster="{index}">show</button>')
        row = [f"{index + 1}", place(one), extent(one.get("frames")), number(one.get("strength")), number(one.get("p")), button]
        rows.append(("", row))
    return _table(("", "where", "when", "strength", "p", ""), rows, "No place or time stands out from the noise.")


def detectable(result: dict) -> Html:
    """The smallest amplitude of each effect that this recording could have revealed."""
    units = {one.get("effect"): one.get("unit") for one in (result.get("evidence") or {}).get("hypotheses") or []}
    found, moved = result.get("detectable") or {}, result.get("detectable_mm")
    tested = sorted((name for name in found if found[name] is not None), key=_order)
    rows = [("", [_effect(name), number(found[name], units.get(name)), *_moved(moved, name)]) for name in tested]
    rows += [("aside", [_effect(name), "untested", *([""] if moved else [])]) for name in sorted(found, key=_order) if found[name] is None]
    return _table(
        ("effect", "would have been seen from", *(["which moves the body by"] if moved else [])),
        rows,
        "Nothing was computed about what this recording could have revealed.",
    )


def _moved(moved: dict | None, name: str) -> list[str]:
    return [number(moved.get(name), "mm")] if moved else []


def notes(result: dict) -> Html:
    """Remarks, and how long it took."""
    said = [str(note) for note in (result.get("evidence") or {}).get("notes") or []]
    floor = (result.get("evidence") or {}).get("noise_floor")
    if floor is not None:
        said.append(f"Noise floor of the tracks: {millimetres(floor)}.")
    if result.get("seconds") is not None:
        said.append(f"The diagnosis took {number(result['seconds'])} s.")
    return Html("<ul>" + "".join(f"<li>{escape(note)}</li>" for note in said) + "</ul>") if said else Html("<p>None.</p>")


def _order(name: str):
    known = list(EFFECTS)
    return known.index(name) if name in known else len(known), name


def _effect(name) -> Html:
    code = f"<code>{escape(str(name))}</code>" if name is not None else ""
    words = effect_name(name)
    return Html(f"{escape(words)} {code}" if name in EFFECTS or name is None else code)


def _likely(chances: dict) -> Html:
    """The likeliest readings, the first first; nothing where it is certain."""
    words = {"adequate": "nothing is missing", "unknown": "something that has no name here"}
    best = [name for name in sorted(chances, key=lambda name: -chances[name]) if chances[name] >= FAINT][:LIKELY]
    said = [f"{escape(words[name]) if name in words else _effect(name)}{_chance(chances[name])}" for name in best]
    return Html("<br>".join(said) if len(best) > 1 else "")


def _chance(value) -> str:
    return "" if value is None else f" ({value:.0%})"


def _bar(gain) -> str:
    """A gain (fraction of the baseline's error) as a bar and a number."""
    if gain is None:
        return "-"
    style = "gain" if gain >= 0 else "loss"
    return f'<span class="bar {style}" style="--size:{min(abs(gain), 1):.3f}"></span>{gain:+.0%}'


def _cell(value) -> str:
    return value if isinstance(value, Html) else escape(str(value))


def _table(header, rows, empty: str) -> Html:
    if not rows:
        return Html(f'<p class="empty">{escape(empty)}</p>')
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in header)
    body = ""
    for style, cells in rows:
        first, *rest = map(_cell, cells)
        body += f'<tr class="{style}"><th scope="row">{first}</th>' + "".join(f"<td>{cell}</td>" for cell in rest) + "</tr>"
    return Html(f'<div class="scroll" tabindex="0"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>')
