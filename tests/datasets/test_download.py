"""Download against a local HTTP server: sizes first, resume, checks, safe unpacking."""

import io
import os
import shutil
import stat
import struct
import threading
import urllib.request
import zipfile
from collections import namedtuple
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
from twinbench.datasets import download as module
from twinbench.datasets.download import download, plan
from twinbench.datasets.unzip import unzip


def archive(files, **kind):
    """A zip file of ``{name: bytes}``; ``kind`` maps a name to the Unix mode of its member."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as out:
        for name, content in files.items():
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = kind.get("mode", stat.S_IFREG | 0o644) << 16
            out.writestr(info, content)
    return stream.getvalue()


NOISE = np.random.default_rng(0).bytes(300_000)  # does not compress: the archive takes many reads
DATA = {"data/different_types/a/final_data.pkl": NOISE, "data/bg.png": b"picture"}
EXPERIMENTS = {"experiments/a/inference.pkl": b"x" * 1000}


class Server:
    """Serves ``files`` and misbehaves as told. ``requests`` records what was asked: (method, path, Range)."""

    def __init__(self, files):
        self.files, self.requests = files, []
        self.ranges = True  # understands Range
        self.cut_after = []  # the next replies end after so many bytes of their body
        self.sizes = True  # tells Content-Length
        self.status = None  # answers every GET with this
        self.lie = 0  # so many bytes more in HEAD than there are
        server = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *_):
                pass

            def do_HEAD(self):
                self.answer(send=False)

            def do_GET(self):
                self.answer(send=True)

            def answer(self, send):
                asked = self.headers.get("Range")
                server.requests.append((self.command, self.path, asked))
                content = server.files.get(self.path.lstrip("/"))
                if content is None or (send and server.status):
                    self.send_response(server.status if content is not None else 404)
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                    return
                start = int(asked.removeprefix("bytes=").rstrip("-")) if asked and server.ranges else 0
                self.send_response(206 if start else 200)
                if start:
                    self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
                body = content[start:]
                if server.sizes:
                    self.send_header("Content-Length", str(len(body) + (0 if send else server.lie)))
                else:
                    self.send_header("Connection", "close")
                    self.close_connection = True
                self.end_headers()
                if not send:
                    return
                if server.cut_after:
                    body = body[: server.cut_after.pop(0)]
                    self.close_connection = True
                self.wfile.write(body)

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.http.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.http.server_port}"
        threading.Thread(target=self.http.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()

    def gets(self):
        return [asked for method, _, asked in self.requests if method == "GET"]


@pytest.fixture
def server(monkeypatch):
    monkeypatch.setattr(module, "_PATIENCE", 0.0)
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    server = Server({"data.zip": archive(DATA), "experiments.zip": archive(EXPERIMENTS)})
    yield server
    server.http.shutdown()
    server.http.server_close()


def contents(folder):
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file() and ".downloaded" not in f.parts}


def test_archives_are_fetched_and_unpacked_and_nothing_else_is_left(server, tmp_path):
    seen = []
    done = download(["data", "experiments"], tmp_path, base_url=server.url, yes=True, progress=lambda *step: seen.append(step))
    assert contents(tmp_path) == DATA | EXPERIMENTS
    sizes = {name: len(server.files[f"{name}.zip"]) for name in ("data", "experiments")}
    assert done.missing == sum(sizes.values())
    for name, size in sizes.items():
        steps = [here for n, here, whole in seen if n == name and whole == size]
        assert steps == sorted(steps) and steps[-1] == size


def test_the_plan_says_how_much_and_fetches_nothing(server, tmp_path):
    size = len(server.files["data.zip"])
    (tmp_path / "data.zip.part").write_bytes(server.files["data.zip"][:1000])
    found = plan(["data", "experiments"], tmp_path, base_url=server.url)
    assert [(a.name, a.size, a.present, a.done) for a in found.archives] == [
        ("data", size, 1000, False),
        ("experiments", len(server.files["experiments.zip"]), 0, False),
    ]
    assert found.missing == size - 1000 + len(server.files["experiments.zip"])
    assert {method for method, _, _ in server.requests} == {"HEAD"}
    text = str(found)
    assert f"to fetch: {found.missing / 1000:.3g} kB" in text and "1 kB already here" in text and "experiments" in text
    assert [f.name for f in tmp_path.iterdir()] == ["data.zip.part"]


def test_a_second_call_fetches_nothing(server, tmp_path):
    download("experiments", tmp_path, base_url=server.url, yes=True)
    server.requests.clear()
    again = download("experiments", tmp_path, base_url=server.url)  # nothing to agree to
    assert again.missing == 0 and again.archives[0].done and "already here" in str(again) and server.gets() == []
    shutil.rmtree(tmp_path / "experiments")
    download("experiments", tmp_path, base_url=server.url, yes=True)
    assert contents(tmp_path) == EXPERIMENTS, "what was deleted is fetched again"


def test_a_cut_connection_is_taken_up_where_it_ended(server, tmp_path):
    server.cut_after = [100_000, 70_000]
    download("data", tmp_path, base_url=server.url, yes=True)
    assert contents(tmp_path) == DATA
    assert server.gets() == [None, "bytes=100000-", "bytes=170000-"]


def test_an_interrupted_download_resumes_in_the_next_call(server, tmp_path):
    def interrupt(name, here, size):
        if here > 50_000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        download("data", tmp_path, base_url=server.url, yes=True, progress=interrupt)
    kept = (tmp_path / "data.zip.part").stat().st_size
    assert [f.name for f in tmp_path.iterdir()] == ["data.zip.part"] and 50_000 < kept < len(server.files["data.zip"])
    server.requests.clear()
    download("data", tmp_path, base_url=server.url, yes=True)
    assert server.gets() == [f"bytes={kept}-"] and contents(tmp_path) == DATA


def test_a_server_that_ignores_range_is_read_from_the_start(server, tmp_path):
    server.ranges = False
    (tmp_path / "data.zip.part").write_bytes(b"z" * 1000)
    download("data", tmp_path, base_url=server.url, yes=True)
    assert contents(tmp_path) == DATA
    assert server.gets() == ["bytes=1000-"], "one answer is enough"


def test_a_part_that_is_longer_than_the_archive_is_dropped(server, tmp_path):
    (tmp_path / "data.zip.part").write_bytes(b"z" * (len(server.files["data.zip"]) + 1))
    assert plan("data", tmp_path, base_url=server.url).archives[0].present == 0
    download("data", tmp_path, base_url=server.url, yes=True)
    assert contents(tmp_path) == DATA


def test_a_complete_part_is_not_fetched_again(server, tmp_path):
    (tmp_path / "data.zip.part").write_bytes(server.files["data.zip"])
    download("data", tmp_path, base_url=server.url)
    assert server.gets() == [] and contents(tmp_path) == DATA


def test_a_server_that_does_not_tell_sizes(server, tmp_path):
    server.sizes = False
    found = plan("data", tmp_path, base_url=server.url)
    assert found.archives[0].size is None and "size not known" in str(found)
    download("data", tmp_path, base_url=server.url, yes=True)
    assert contents(tmp_path) == DATA


def test_a_server_that_never_sends_the_end_is_given_up_with_what_came_kept(server, tmp_path):
    server.cut_after = [10_000] + [0] * 20
    size = len(server.files["data.zip"])
    with pytest.raises(ConnectionError, match=rf"data.zip: stopped at 10000 of {size} bytes .*call again to go on"):
        download("data", tmp_path, base_url=server.url, yes=True)
    assert (tmp_path / "data.zip.part").read_bytes() == server.files["data.zip"][:10_000]


def test_a_file_shorter_than_promised_is_no_success(server, tmp_path):
    server.lie = 5
    with pytest.raises(ConnectionError, match=r"data.zip"):
        download("data", tmp_path, base_url=server.url, yes=True)
    assert not (tmp_path / "data").exists()


def test_a_file_longer_than_promised_is_no_success(server, tmp_path):
    server.lie = -5
    with pytest.raises(ConnectionError, match=r"data.zip: .*more than the \d+ bytes that the server spoke of"):
        download("data", tmp_path, base_url=server.url, yes=True)
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("name", ["gaussian_output"])
def test_an_archive_that_is_not_there(server, tmp_path, name):
    with pytest.raises(ConnectionError, match=r"gaussian_output.zip: the server answered 404"):
        download(name, tmp_path, base_url=server.url, yes=True)
    server.status = 503
    with pytest.raises(ConnectionError, match=r"data.zip.*503"):
        download("data", tmp_path, base_url=server.url, yes=True)


def test_no_network(tmp_path, server):
    server.http.shutdown()
    server.http.server_close()
    with pytest.raises(ConnectionError, match=r"data.zip: cannot be reached .*is there a network\?"):
        plan("data", tmp_path, base_url=server.url)


def test_unknown_archives_and_disagreement(server, tmp_path, monkeypatch, capsys):
    with pytest.raises(ValueError, match=r"unknown archive 'dat'; did you mean 'data'\?"):
        plan("dat", tmp_path, base_url=server.url)
    with pytest.raises(ValueError, match="no archive named"):
        plan([], tmp_path, base_url=server.url)
    with pytest.raises(ValueError, match="pass yes=True"):
        download("data", tmp_path, base_url=server.url)
    assert "to fetch" in capsys.readouterr().out

    class Terminal(io.StringIO):
        def isatty(self):
            return True

    for answer, agreed in (("n\n", False), ("\n", False), ("y\n", True)):
        monkeypatch.setattr("sys.stdin", Terminal(answer))
        if agreed:
            download("data", tmp_path, base_url=server.url)
        else:
            with pytest.raises(ValueError, match="not agreed to"):
                download("data", tmp_path, base_url=server.url)
            assert list(tmp_path.iterdir()) == []
    assert contents(tmp_path) == DATA


def test_a_disk_that_is_too_small_is_found_before(server, tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**9, 10**9, 1000))
    with pytest.raises(OSError, match=r"to fetch, but only 1 kB free"):
        download("data", tmp_path, base_url=server.url, yes=True)
    assert server.gets() == []
    (tmp_path / "big.zip").write_bytes(archive({"a": b"\0" * 100_000}))
    with pytest.raises(OSError, match="unpacking needs"):
        unzip(tmp_path / "big.zip", tmp_path / "out")
    assert not contents(tmp_path / "out")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_disk_that_fills_up_on_the_way_keeps_what_came(server, tmp_path):
    (tmp_path / "data.zip.part").symlink_to("/dev/full")
    with pytest.raises(OSError, match=r"data.zip.part: cannot be written \(No space left"):
        download("data", tmp_path, base_url=server.url, yes=True)


def test_the_published_archives_are_asked_for_where_they_are(monkeypatch, tmp_path):
    asked = []

    def answer(request, timeout):
        asked.append((request.method, request.full_url))
        raise urllib.error.URLError("no network in tests")

    monkeypatch.setattr(urllib.request, "urlopen", answer)
    with pytest.raises(ConnectionError, match=r"huggingface.co"):
        plan(list(module.ARCHIVES), tmp_path)
    assert asked == [("HEAD", "https://huggingface.co/datasets/Jianghanxiao/PhysTwin/resolve/main/data.zip")]


# --- unpacking ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["../evil", "a/../../evil", "/evil", "C:/evil", "a\\..\\evil", "a/b/../../../evil", "//evil"])
def test_names_that_lead_out_of_the_folder_are_refused(tmp_path, name):
    (tmp_path / "data.zip").write_bytes(archive({"good": b"good", name: b"evil"}))
    with pytest.raises(ValueError, match=r"data.zip: refused, its member .* leads out of the folder"):
        unzip(tmp_path / "data.zip", tmp_path / "out" / "in")
    assert [f.name for f in tmp_path.rglob("*") if f.is_file()] == ["data.zip"], "not even the good member is unpacked"


@pytest.mark.parametrize("mode", [stat.S_IFLNK | 0o777, stat.S_IFIFO | 0o644, stat.S_IFCHR | 0o644])
def test_links_and_devices_are_refused(tmp_path, mode):
    (tmp_path / "data.zip").write_bytes(archive({"link": b"/etc/passwd"}, mode=mode))
    with pytest.raises(ValueError, match="its member 'link' is a link or a device"):
        unzip(tmp_path / "data.zip", tmp_path / "out")


def test_two_members_of_one_name_are_refused(tmp_path):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as out, pytest.warns(UserWarning, match="Duplicate"):
        out.writestr("a", b"1")
        out.writestr("a", b"2")
    (tmp_path / "data.zip").write_bytes(stream.getvalue())
    with pytest.raises(ValueError, match="one name twice"):
        unzip(tmp_path / "data.zip", tmp_path / "out")
    (tmp_path / "data.zip").write_bytes(archive({"a": b"1", "a/b": b"2"}))
    with pytest.raises(ValueError, match="'a/b' lies in a folder that is also a file"):
        unzip(tmp_path / "data.zip", tmp_path / "out")


def test_a_damaged_archive_leaves_what_was_there(tmp_path):
    whole = archive(DATA)
    out = tmp_path / "out"
    (out / "data").mkdir(parents=True)
    (out / "data" / "bg.png").write_bytes(b"mine")
    flipped = bytearray(whole)
    flipped[1000] ^= 1  # within the noise
    encrypted = bytearray(whole)
    struct.pack_into("<H", encrypted, 6, 1)
    central = whole.index(b"PK\x01\x02")
    struct.pack_into("<H", encrypted, central + 8, 1)
    for bad, message in (
        (whole[:-100], "damaged"),
        (bytes(flipped), "damaged"),
        (b"not a zip", "damaged"),
        (bytes(encrypted), "encrypted"),
    ):
        (tmp_path / "data.zip").write_bytes(bad)
        with pytest.raises(ValueError, match=f"data.zip: .*{message}"):
            unzip(tmp_path / "data.zip", out)
        assert contents(out) == {"data/bg.png": b"mine"}


def test_archives_that_share_a_folder_are_merged(tmp_path):
    for name, files in (("one", {"data/a/x": b"1", "data/a/y": b"1"}), ("two", {"data/b/x": b"2", "data/a/y": b"2"})):
        (tmp_path / f"{name}.zip").write_bytes(archive(files))
        assert unzip(tmp_path / f"{name}.zip", tmp_path / "out") == ["data"]
    assert contents(tmp_path / "out") == {"data/a/x": b"1", "data/a/y": b"2", "data/b/x": b"2"}


def test_a_damaged_download_is_not_taken_for_done(server, tmp_path):
    server.files["data.zip"] = server.files["data.zip"][:-100]
    with pytest.raises(ValueError, match=r"data.zip: damaged, delete it and fetch it again"):
        download("data", tmp_path, base_url=server.url, yes=True)
    assert not plan("data", tmp_path, base_url=server.url).archives[0].done and not (tmp_path / "data").exists()
