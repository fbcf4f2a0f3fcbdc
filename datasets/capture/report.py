"""The quality report of a case: one HTML page without scripts, with its pictures inside."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path

import numpy as np

from ..temporary import replacing

__all__ = ["write_report"]

_STYLE = "body{font:15px sans-serif;margin:2em auto;max-width:70em;color:#222}table{border-collapse:collapse;margin:1em 0}"
_STYLE += "td,th{border:1px solid #ccc;padding:.3em .7em;text-align:right}th:first-child,td:first-child{text-align:left}img{margin:.2em 0}"


def write_report(out: Path, recording, timing, sights, scenario, quality) -> Path:
    """Write ``out / report.html`` and return it."""
    parts = [f"<h1>{escape(scenario.name)}</h1>", _summary(recording, timing, scenario, quality)]
    parts += ["<h2>What it cannot be used for, and what to look at</h2><ul>"]
    parts += [f"<li>{escape(one)}</li>" for one in quality.warnings] + ["</ul><h2>Cameras</h2>", _table(quality, timing)]
    parts += ["<h2>How long points are seen</h2>", _histogram(quality.lengths, scenario.frame_count), "<h2>Pictures</h2>"]
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
        f"the cameras' frames that belong together were taken {1000 * timing.spread:.1f} ms apart (median); points are moved to one time",
    ]
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in said) + "</ul>"


def _table(quality, timing):
    heads = [
        "camera",
        "depth on object",
        "tracks alive",
        "reprojection [pixel]",
        "depth noise [mm]",
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
        ]
        values += [offset, drift, str(len(one.dropped)), f"{1000 * clock.jitter:.2f}"]
        rows.append("<tr>" + "".join(f"<td>{escape(v)}</td>" for v in values) + "</tr>")
    return "<table><tr>" + "".join(f"<th>{escape(h)}</th>" for h in heads) + "</tr>" + "".join(rows) + "</table>"


def _histogram(lengths, frames):
    counts, edges = np.histogram(lengths, bins=10, range=(0, frames))
    top = max(counts.max(), 1)
    bars = "".join(
        f"<rect x='{44 * k}' y='{100 - 100 * n / top:.1f}' width='40' height='{100 * n / top:.1f}' fill='#4878a8'/>"
        f"<text x='{44 * k}' y='116' font-size='11'>{edges[k]:.0f}-{edges[k + 1]:.0f}</text>"
        for k, n in enumerate(counts)
    )
    return f"<svg width='450' height='120'>{bars}</svg><p>frames; {len(lengths)} points</p>"


def _pictures(raw, frames, sight):
    """Rows of pictures at three instants."""
    import cv2

    for t in sorted({0, len(frames) // 2, len(frames) - 1}):
        color = raw.frames.color(int(frames[t]))
        masked = color.copy()
        masked[sight.object[t]] = (0.5 * masked[sight.object[t]] + [0, 110, 0]).astype(np.uint8)
        masked[sight.hand_mask[t]] = (0.5 * masked[sight.hand_mask[t]] + [120, 0, 0]).astype(np.uint8)
        tracked = color.copy()
        for pixel, seen in zip(sight.pixels[t][::3], sight.visible[t][::3], strict=True):
            cv2.circle(tracked, (round(pixel[0]), round(pixel[1])), 1, (255, 255, 255) if seen else (120, 120, 120), -1)
        row = np.concatenate([color, masked, tracked], axis=1)
        scale = min(1.0, 1290 / row.shape[1])
        row = cv2.resize(row, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        _, data = cv2.imencode(".jpg", np.ascontiguousarray(row[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 85])
        yield f"<img alt='frame {t}' src='data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}'>"
