"""What is derived of an immutable object: made once, and forgotten with the object.

A radio map's index or a site's ground takes tenths of a second and over ten megabytes, and is asked
for with every scan. A server that runs for months sees many maps and sites, one for each edit; so
what was made of one goes when its last session does, and not when some number of others came.
"""

from collections.abc import Callable
from functools import update_wrapper
from typing import Generic, TypeVar, TypeVarTuple
from weakref import WeakKeyDictionary

Source = TypeVar("Source")
Made = TypeVar("Made")
Ts = TypeVarTuple("Ts")

PARAMETER_SETS = 32
"""Few profiles derive the same; only a search over parameters asks with more."""


class Derived(Generic[Source, *Ts, Made]):
    """A function that makes each thing once and keeps it as long as its source lives.

    Parameters
    ----------
    function
        Of a source that is compared by identity and can be weakly referenced, and of hashable
        arguments. What it returns must not hold the source, which would never go then.
    most
        Things kept of one source; with one more all of them are made anew.
    """

    def __init__(self, function: Callable[[Source, *Ts], Made], most: int) -> None:
        self._function = function
        self._most = most
        self._kept: WeakKeyDictionary[Source, dict[tuple[*Ts], Made]] = WeakKeyDictionary()
        update_wrapper(self, function)

    def __call__(self, source: Source, *arguments: *Ts) -> Made:
        """Return what is made of a source with these arguments."""
        of_source = self._kept.setdefault(source, {})
        found = of_source.get(arguments)
        if found is None:
            found = self._function(source, *arguments)
            if len(of_source) >= self._most:
                of_source.clear()
            of_source[arguments] = found
        return found

    def kept_of(self, source: Source) -> int:
        """Return how many things are kept of a source."""
        return len(self._kept.get(source, {}))


def derived(
    most: int = PARAMETER_SETS,
) -> Callable[[Callable[[Source, *Ts], Made]], Derived[Source, *Ts, Made]]:
    """Return the decorator of functions that are to be `Derived`."""

    def decorated(function: Callable[[Source, *Ts], Made]) -> Derived[Source, *Ts, Made]:
        return Derived(function, most)

    return decorated
