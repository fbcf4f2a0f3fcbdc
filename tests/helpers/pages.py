"""Pages as tests look at them: parsed, and opened in a browser without a screen."""

import os
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

__all__ = ["Browser", "Document"]

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "chrome")
QUIET = ("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-quic")


class Document(HTMLParser):
    """What a browser would find: text outside scripts, the content of scripts by id, elements and their attributes."""

    def __init__(self, text):
        super().__init__()
        self.scripts, self.text, self.elements, self.inside = {}, "", [], None
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self.inside = dict(attrs).get("id", "") if tag in ("script", "style") else None

    def handle_endtag(self, tag):
        self.inside = None

    def handle_data(self, data):
        if self.inside is None:
            self.text += data
        else:
            self.scripts[self.inside] = self.scripts.get(self.inside, "") + data


class Browser:
    """Opens pages without a screen. What it keeps is in ``folder``."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.program = next(filter(None, map(shutil.which, PROGRAMS)), None)

    def __call__(self, path: Path, probe: str = "", *, width: int = 1200):
        """The data of the page's root, what the console said, and the document, after two seconds of the page's own clock.

        ``probe`` is script that runs after the page's own; the page's policy, which would not let it, is left out then.
        """
        page = path
        if probe:
            source = re.sub(r"<meta http-equiv.*?>\n", "", path.read_text(encoding="utf-8"))
            page = self.folder / "probed.html"
            page.write_text(source.replace("</body>", f"<script>{probe}</script></body>"), encoding="utf-8")
        command = [self.program, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", *QUIET]
        command += [f"--user-data-dir={self.folder / 'profile'}", "--virtual-time-budget=2000", f"--window-size={width},900", "--dump-dom"]
        environment = {**os.environ, "HOME": str(self.folder)}
        done = subprocess.run([*command, page.as_uri()], capture_output=True, text=True, timeout=120, env=environment)
        document = Document(done.stdout)
        return document.elements[0][1], [line for line in done.stderr.splitlines() if "CONSOLE" in line], document
