"""Processes that come and go, and waiting for them."""

import time


def alive(process):
    """Whether it runs; one that has ended and is not yet fetched does not."""
    try:
        with open(f"/proc/{process}/stat") as stat:
            return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def until(true, late):
    """Wait until ``true()``, at most ``late`` seconds."""
    late += time.monotonic()
    while not true():
        assert time.monotonic() < late
        time.sleep(0.05)
