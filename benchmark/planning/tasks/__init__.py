"""Tasks, a file each or several of a kind in one: what has ``TASKS`` here is found."""

from .base import Task, get_task, tasks

__all__ = ["Task", "get_task", "tasks"]
