"""What somebody may have meant who wrote an unknown name. It stands below all rooms."""

from difflib import get_close_matches

__all__ = ["nearest"]


def nearest(name: str, known) -> str:
    """'did you mean ...? known: ...' for an unknown ``name``."""
    known = [str(k) for k in known]
    close = get_close_matches(str(name), known, n=1, cutoff=0.5)
    shown = ", ".join(known[:30]) + (f" and {len(known) - 30} more" if len(known) > 30 else "")
    return (f"did you mean {close[0]!r}? " if close else "") + f"known: {shown}"
