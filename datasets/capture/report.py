"""The quality report of a case: one HTML page without scripts, with its pictures inside."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path

import numpy as np

from ..temporary import replacing

__all__ = ["write_report"]

TRACKS = 400  # of a camera that are drawn
_STYLE = "body{font:15px sans-serif;margin:2em auto;max-width:70em;color:#222}table{border-collapse:collapse;margin:1em 0}"
_STYLE += "td,th{border:1px solid #ccc;padding:.3em .7em;text-align:right}th:first-child,td:first-child{text-align:left}"
_STYLE += "figure{margin:.4em .6em .4em 0;display:inline-block}img{max-width:100%}figcaption{font-size:13px;color:#555}"


def write_report(out: Path, recording, timing, sights, scenario, quality) -> Path:
    """Write ``out / report.html`` and return it."""
    parts = [f"<h1>{escape(scenario.name)}</h1>", _summary(recording, timing, scenario, quality)]
    parts += ["<h2>What it cannot be used for, and what to look at</h2><ul>"]
    parts += [f"<li>{escape(one)}</li>" for one in quality.warnings] + ["</ul><h2>Cameras</h2>", _table(quality, timing)]
    parts += ["<h2>How long points are seen</h2>", _histogram(quality.lengths, scenario.frame_count), "<h2>The body</h2>"]
    parts += ["<p>Tracked points blue, hands red; in frame 0 also the shape: surface dark grey, inside light grey.</p>", *_bodies(scenario)]
    parts += ["<h2>Pictures</h2>"]
    parts += ["<p>First, middle and last frame: the picture, the masks (object green, hands red), the tracks (seen white, lost grey).</p>"]
    for number, raw in enumerate(recording.cameras):
        parts += [f"<h3>Camera {escape(raw.name)}</h3>", *(_pictures(raw, timing.frames[number], sights[number]))]
    title = escape(scenario.name)
    page = f"<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>{title}</title><style>{_STYLE}</style></head><body>"
    file = Path(out) / "report.html"
    with replacing(file) as temporary:
        temporary.write_text(page + "\n".join(parts) + "</body></html>", encoding="utf-8")
    return file


def _summary(recording, timing, scenario, quality):
    tracked, surface, interior = scenario.counts
    said = [
        f"{len(recording.cameras)} camera{'s' * (len(recording.cameras) != 1)}, {scenario.frame_count} frames at {timing.fps:.2f} a second",
        f"{tracked} tracked, {surface} surface and {interior} interior points, {scenario.controllers.shape[1]} controllers",
        f"{100 * quality.alive:.0f} % of the tracked points are seen in the last frame",
        f"tracks on hands miss a rigid motion by {1000 * quality.hand:.1f} mm (median)",
    ]
    if np.isfinite(quality.unseen):
        said.append(f"{100 * quality.unseen:.0f} % of the surface was seen by no camera in frame 0")
    if len(recording.cameras) > 1:
        apart = f"{1000 * timing.spread:.1f} ms apart (median)"
        said.append(f"the cameras' frames that belong together were taken {apart}; points are moved to one time")
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in said) + "</ul>"


def _table(quality, timing):
    heads = [
        "camera",
        "depth on object",
        "tracks alive",
        "reprojection [pixel]",
        "depth noise [mm]",
        "texture [levels/pixel]",
        "clock [ms]",
        "drift [ppm]",
        "dropped",
        "jitter [ms]",
    ]
    rows = []
    for one, clock in zip(quality.cameras, timing.clocks, strict=True):
        offset = "-" if one.offset is None else f"{1000 * (one.offset - (quality.cameras[0].offset or 0.0)):.1f}"
        drift = "-" if one.drift is None else f"{one.drift:.0f}"
        values = [
            one.name,
            f"{100 * one.coverage:.0f} %",
            f"{100 * one.alive:.0f} %",
            f"{one.reprojection:.2f}",
            f"{1000 * one.depth_noise:.2f}",
            f"{one.texture:.1f}",
        ]
        values += [offset, drift, str(len(one.dropped)), f"{1000 * clock.jitter:.2f}"]
        rows.append("<tr>" + "".join(f"<td>{escape(v)}</td>" for v in values) + "</tr>")
    return "<table><tr>" + "".join(f"<th>{escape(h)}</th>" for h in heads) + "</tr>" + "".join(rows) + "</table>"


def _histogram(lengths, frames):
    """Bars of whole numbers of frames, at most ten."""
    edges = np.unique(np.round(np.linspace(0, frames, 11)).astype(int))  # bar k: more than edges[k] and at most edges[k + 1] frames
    counts = np.histogram(lengths, bins=edges + 0.5)[0]
    top = max(counts.max(), 1)
    bars = "".join(
        f"<rect x='{50 * k}' y='{14 + 86 * (1 - n / top):.1f}' width='46' height='{86 * n / top:.1f}' fill='#4878a8'/>"
        f"<text x='{50 * k + 23}' y='{10 + 86 * (1 - n / top):.1f}' font-size='11' text-anchor='middle'>{n or ''}</text>"
        f"<text x='{50 * k + 23}' y='114' font-size='11' text-anchor='middle'>{_range(edges[k] + 1, edges[k + 1])}</text>"
        for k, n in enumerate(counts)
    )
    return f"<svg width='{50 * len(counts)}' height='118'>{bars}</svg><p>Points by the frames in which they are seen, of {frames}.</p>"


def _range(first, last):
    return f"{first}" if first == last else f"{first}-{last}"


def _bodies(scenario):
    """The case as points, from the side and from above, in its first and last frame."""
    up = -np.asarray(scenario.gravity) / np.linalg.norm(scenario.gravity)
    across = np.linalg.svd(up[None])[2][1]
    axes = np.array([across, np.cross(up, across), up])
    shown = []
    for t in (0, scenario.frame_count - 1):
        parts = [(scenario.points[t][scenario.visible[t]], "#2060c0"), (scenario.controllers[t], "#d03030")]
        if t == 0:
            parts = [(scenario.interior, "#d8d8d8"), (scenario.surface, "#909090"), *parts]
        shown.append((t, [(points @ axes.T, paint) for points, paint in parts]))
    everything = np.concatenate([points for _, parts in shown for points, _ in parts])
    low, scale = everything.min(0), 300 / max(np.ptp(everything, axis=0).max(), 1e-6)
    for t, parts in shown:
        for name, (u, v) in (("from the side", (0, 2)), ("from above", (0, 1))):
            height = scale * np.ptp(everything[:, v]) + 10
            dots = "".join(
                f"<circle cx='{5 + scale * (p[u] - low[u]):.1f}' cy='{height - 5 - scale * (p[v] - low[v]):.1f}' r='1.5' fill='{paint}'/>"
                for points, paint in parts
                for p in points[:: max(len(points) // 400, 1)]
            )
            yield f"<figure><svg width='310' height='{height:.0f}'>{dots}</svg><figcaption>frame {t}, {name}</figcaption></figure>"


def _pictures(raw, frames, sight):
    """Rows of pictures at three instants."""
    import cv2

    count = sight.pixels.shape[1]
    some = np.random.default_rng(0).choice(count, min(count, TRACKS), replace=False)  # every third in a row would look like stripes
    for t in sorted({0, len(frames) // 2, len(frames) - 1}):
        color = raw.frames.color(int(frames[t]))
        masked = color.copy()
        masked[sight.object[t]] = (0.5 * masked[sight.object[t]] + [0, 110, 0]).astype(np.uint8)
        masked[sight.hand_mask[t]] = (0.5 * masked[sight.hand_mask[t]] + [120, 0, 0]).astype(np.uint8)
        tracked = color.copy()
        for pixel, seen in zip(sight.pixels[t][some], sight.visible[t][some], strict=True):
            cv2.circle(tracked, (round(pixel[0]), round(pixel[1])), 1, (255, 255, 255) if seen else (120, 120, 120), -1)
        row = np.concatenate([color, masked, tracked], axis=1)
        scale = min(1.0, 1290 / row.shape[1])
        row = cv2.resize(row, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        _, data = cv2.imencode(".jpg", np.ascontiguousarray(row[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 85])
        source = f"data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}"
        yield f"<figure><img alt='frame {t}' src='{source}'><figcaption>frame {t}</figcaption></figure>"
