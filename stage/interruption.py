"""Ctrl-C, also where it arrives inside compiled code."""

from __future__ import annotations


def interrupted(error: BaseException) -> bool:
    """Whether an exception is Ctrl-C.

    One that arrives while a compiled kernel runs comes out as a ``SystemError`` that it caused.
    """
    if isinstance(error, SystemError) and error.__cause__ is not None:
        return interrupted(error.__cause__)
    return isinstance(error, KeyboardInterrupt)
