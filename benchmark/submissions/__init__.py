"""Submissions: roll-outs of methods whose code is not here, in the format of docs/submissions.md, checked and scored as runs are."""

from __future__ import annotations

from .checking import check, checked
from .format import Rollout, Submission
from .scoring import score
from .template import write_template
from .writing import write_submissions

__all__ = ["Rollout", "Submission", "check", "checked", "score", "write_submissions", "write_template"]
