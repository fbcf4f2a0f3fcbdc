"""What cameras see, in a browser: a page without scripts, each camera as a stream of JPEG pictures with its counts."""

from __future__ import annotations

import threading
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import quote, unquote

import numpy as np

__all__ = ["Preview", "picture_of"]

EVERY = 0.15  # s between two pictures of a stream: looking must not cost the recording frames
FARTHEST = 1.5  # m of the colours of depth: as far as depth counts
_PAGE = "<!DOCTYPE html><html lang='en'><head><meta charset='utf-8'><title>twinbench capture</title><style>body{font:15px sans-serif;"
_PAGE += "margin:1em}img{max-width:100%;display:block}</style></head><body><form method='post' action='stop'><button>Stop</button></form>"


class Preview:
    """Serves the cameras that ``show`` was last given on ``port`` of this computer; 0 is any free one. Use it in a with statement.

    ``stopped`` is true once somebody pressed Stop, and afterwards.
    """

    def __init__(self, port: int = 0):
        self.cameras, self.stopped = [], False
        preview = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                _answer(self, preview)

            def do_POST(self):
                preview.stopped = preview.stopped or self.path == "/stop"
                self.send_response(HTTPStatus.SEE_OTHER if self.path == "/stop" else HTTPStatus.NOT_FOUND)
                self.send_header("Location", "/")
                self.end_headers()

            def log_message(self, *_):
                pass  # standard error belongs to what is being recorded

        try:
            self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        except OSError as error:
            raise ValueError(f"preview port {port}: cannot be opened ({error.strerror}): choose another, or 0 for any") from None
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_port}/"

    def __enter__(self):
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.stopped = True  # ends the streams that browsers still watch
        self._server.shutdown()
        self._server.server_close()

    def show(self, cameras: list) -> None:
        self.cameras = list(cameras)


def _answer(handler, preview):
    name = unquote(handler.path.removeprefix("/").removesuffix(".mjpg"))
    camera = next((one for one in preview.cameras if one.name == name), None)
    if handler.path == "/":
        page = _PAGE + ("<p>Stopped.</p>" if preview.stopped else "")
        page += "".join(f"<img alt='{quote(one.name)}' src='{quote(one.name)}.mjpg'>" for one in preview.cameras) + "</body></html>"
        handler.send_response(HTTPStatus.OK)
        handler.send_header("Content-Type", "text/html; charset=utf-8")
        handler.end_headers()
        handler.wfile.write(page.encode())
    elif camera is None:
        handler.send_error(HTTPStatus.NOT_FOUND)
    else:
        _stream(handler, camera, preview)


def _stream(handler, camera, preview):
    import cv2

    handler.send_response(HTTPStatus.OK)
    handler.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
    handler.end_headers()
    try:
        while not preview.stopped and camera in preview.cameras:
            _, data = cv2.imencode(".jpg", picture_of(camera)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])
            handler.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(data) + data.tobytes() + b"\r\n")
            time.sleep(EVERY)
    except OSError:
        pass  # the browser went away


def picture_of(camera) -> np.ndarray:
    """(H, 2 W, 3) uint8 RGB: colour, depth in colours (near red, far blue, none black), and what came and was dropped."""
    import cv2

    color, depth = camera.color, camera.depth
    color = np.zeros((240, 424, 3), np.uint8) if color is None else color
    if depth is None:
        shades = np.zeros_like(color)
    else:
        share = np.clip(1 - depth * camera.depth_unit / FARTHEST, 0, 1)
        shades = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1] * (depth > 0)[..., None]
        shades = cv2.resize(np.ascontiguousarray(shades), color.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    both = np.ascontiguousarray(np.concatenate([color, shades], axis=1))
    said = f"{camera.name}: {camera.frames} frames, {camera.dropped} dropped"
    for paint, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(both, said, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, paint, width, cv2.LINE_AA)
    return both
