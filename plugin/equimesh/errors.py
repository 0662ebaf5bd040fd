"""What equimesh says when it cannot go on."""

from __future__ import annotations

__all__ = ["Cancelled", "InputError"]


class InputError(ValueError):
    """The input cannot be meshed; the message is one sentence: what is wrong and what to do."""


class Cancelled(RuntimeError):
    """The caller's ``progress`` returned False; nothing was written or changed."""
