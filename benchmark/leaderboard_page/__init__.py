"""The leaderboard as one HTML file that needs no network: runs and submissions side by side, and where each comes from."""

from __future__ import annotations

from .gather import Entry, Gathered, gather
from .page import page, write_page

__all__ = ["Entry", "Gathered", "gather", "page", "write_page"]
