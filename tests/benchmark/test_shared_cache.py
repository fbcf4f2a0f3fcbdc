"""One cache, several nodes at once: with the locks of a local disk, and without any, as network disks have none for folders."""

import errno
import json
import multiprocessing
import os
import time

import numpy as np
import pytest
from twinbench.benchmark.cache import Cache, digest
from twinbench.benchmark.opening import open_recordings
from twinbench.benchmark.plan import plan
from twinbench.benchmark.runner import Runner, Settings
from twinbench.datasets import temporary
from twinbench.methods.registry import methods
from twinbench.metrics.base import metrics

ROUNDS = 25
SIZE = 20_000  # numbers of an entry: written in many pieces


def without_locks():
    """What a network disk says of a lock on a folder."""

    def refuse(*_):
        raise OSError(errno.EBADF, "no locks here")

    temporary.fcntl.flock = refuse


def write(root, locks, barrier, who, failed):
    """Store the same entries as others do, at the same time; every process has its own content, as fits differ in their last digits."""
    locks or without_locks()
    cache = Cache(root)
    try:
        for k in range(ROUNDS):
            barrier.wait()
            cache.write("rows", digest(k), {"row": [who] * 500})
            cache.write_folder("fits", digest(k), lambda folder: np.save(folder / "twin.npy", np.full(SIZE, who)), {"note": str(who)})
            found = cache.read_folder("fits", digest(k))
            assert found is not None, "what was just stored must be there"
            values = np.load(found[0] / "twin.npy")  # and what was found must stay readable
            assert len(values) == SIZE and len(set(values)) == 1
    except Exception as error:
        failed.put(f"writer {who}: {error!r}")
        barrier.abort()


def read(root, done, failed, seen):
    """Look at the entries while they are written: each is whole or not there."""
    cache = Cache(root)
    try:
        while not done.is_set():
            for k in range(ROUNDS):
                row, fit = cache.read("rows", digest(k)), cache.read_folder("fits", digest(k))
                file = cache.root / "rows" / digest(k)[:2] / f"{digest(k)}.json"
                assert row is None or len(set(row["row"])) == 1
                if row is None and file.exists():
                    json.loads(file.read_text())  # never half of it, whoever is writing
                if fit is not None:
                    assert len(set(np.load(fit[0] / "twin.npy"))) == 1
                    seen.value += 1
    except Exception as error:
        failed.put(f"reader: {error!r}")


@pytest.mark.parametrize("locks", [True, False], ids=["locks", "no locks"])
def test_entries_that_two_write_at_once_are_never_half_read(tmp_path, locks):
    context = multiprocessing.get_context("fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn")
    barrier, done, failed, seen = context.Barrier(2), context.Event(), context.Queue(), context.Value("i", 0)
    root = tmp_path / "cache"
    reader = context.Process(target=read, args=(root, done, failed, seen))
    writers = [context.Process(target=write, args=(root, locks, barrier, who, failed)) for who in (1, 2)]
    for process in (reader, *writers):
        process.start()
    for process in writers:
        process.join()
    time.sleep(0.2)
    done.set()
    reader.join()
    assert failed.empty(), failed.get()
    cache = Cache(root)
    assert len([entry for entry in cache.entries() if cache.sound(entry)]) == 2 * ROUNDS and seen.value > 0
    assert not list((root / "tmp").iterdir())  # nothing is left over


def fit(root, barrier, queue):
    """The rows of one fit, begun when the other process is ready too."""
    opened = open_recordings("sample", split="published", cache=Cache(root))
    common = Settings({"rigid": methods()["rigid"]}, {"track_error": metrics()["track_error"]})
    fits = plan(opened.collection, methods=common.methods, tasks=("prediction",), scenarios=opened.collection.in_domain[:1])
    runner = Runner(opened, common, Cache(root))
    barrier.wait()
    queue.put([row["track_error"] for row in runner.run(fits)])


@pytest.mark.slow
def test_two_nodes_that_fit_the_same_thing_at_once_agree(tmp_path):
    context = multiprocessing.get_context("spawn")
    barrier, queue = context.Barrier(2), context.Queue()
    nodes = [context.Process(target=fit, args=(tmp_path, barrier, queue)) for _ in range(2)]
    for node in nodes:
        node.start()
    one, other = queue.get(timeout=60), queue.get(timeout=60)
    for node in nodes:
        node.join()
    assert one == other and np.isfinite(one).all()
    cache = Cache(tmp_path)
    assert [len(list(cache.entries(kind))) for kind in ("fits", "rows")] == [1, 1] and all(map(cache.sound, cache.entries()))


def test_a_damaged_entry_is_replaced_without_locks(tmp_path, monkeypatch):
    monkeypatch.setattr(temporary.fcntl, "flock", lambda *_: (_ for _ in ()).throw(OSError(errno.EBADF, "no locks here")))
    cache, key = Cache(tmp_path), digest("one")
    cache.write_folder("fits", key, lambda folder: (folder / "a").write_text("good"), {})
    (tmp_path / "fits" / key / "content" / "a").write_text("bad")
    assert cache.read_folder("fits", key) is None
    cache.write_folder("fits", key, lambda folder: (folder / "a").write_text("good"), {})
    assert (cache.read_folder("fits", key)[0] / "a").read_text() == "good" and not list((tmp_path / "tmp").iterdir())


def test_names_that_are_needed_stay_young(tmp_path, monkeypatch):
    monkeypatch.setattr(temporary, "HOUR", 0.02)
    with pytest.raises(OSError, match=r"^nothing of the disk's$"), temporary.lasting(tmp_path, tmp_path / "mark") as made:
        os.utime(made, (0, 0))
        late = time.monotonic() + 10
        while made.stat().st_mtime < 1e9 and time.monotonic() < late:
            time.sleep(0.01)
        assert time.time() - made.stat().st_mtime < 60
        raise OSError("nothing of the disk's")
    assert not list(tmp_path.iterdir())
