"""Twins that are simulated live, under hands that somebody moves: the core, the page in a browser, and films."""
