"""Whole numbers as users give them: seeds, starts, and limits of iterations."""

from __future__ import annotations

from numbers import Integral

from cotree.errors import ParameterError, brief


def check_whole(value: object, what: str, least: int = 0) -> int:
    """Accept a whole number that is not too small.

    Parameters
    ----------
    value : object
        What was given.
    what : str
        What it is, for the message.
    least : int
        The smallest number that is accepted.

    Raises
    ------
    ParameterError
        If it is no whole number, or below ``least``.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise ParameterError(
            f"{what} is {brief(repr(value))}: give a whole number of at least {least}"
        )
    return int(value)
