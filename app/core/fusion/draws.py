"""Random draws by number, without a generator's hidden state.

A counter-based generator (Salmon et al., SC 2011) is a hash of a counter: the same number gives the
same draw on any machine and in any order, so a filter that keeps count of its draws can be stored,
restored and run again bit for bit. The hash is the finaliser of SplitMix64 (Steele, Lea and Flood,
OOPSLA 2014).
"""

import math

import numpy as np
from numba import njit

_STEP = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S11, _S16, _S27, _S30, _S31 = (np.uint64(bits) for bits in (11, 16, 27, 30, 31))
_LOW16 = np.uint64(0xFFFF)

# Four uniform 16-bit numbers have mean 2 (2^16 - 1) and variance (2^32 - 1) / 3.
_MEAN_OF_FOUR = 2.0 * 65535.0
_SIGMA_OF_FOUR = math.sqrt((65536.0**2 - 1.0) / 3.0)
_TO_UNIT = 2.0**-53


@njit(cache=True)
def hashed(number: int) -> np.uint64:  # pragma: no cover - compiled
    """Return the 64 random bits of a number."""
    z = np.uint64(number + 1) * _STEP
    z = (z ^ (z >> _S30)) * _FIRST
    z = (z ^ (z >> _S27)) * _SECOND
    return z ^ (z >> _S31)


@njit(cache=True)
def uniform(number: int) -> float:  # pragma: no cover - compiled
    """Return a draw from [0, 1)."""
    return float(hashed(number) >> _S11) * _TO_UNIT


@njit(cache=True)
def normal(number: int) -> float:  # pragma: no cover - compiled
    """Return a draw with mean 0, variance 1 and a nearly normal distribution.

    The sum of four uniform numbers (Irwin and Hall): none lies beyond 3.46, which the noise of a
    step does not need, and it costs a tenth of a logarithm and a sine.
    """
    bits = hashed(number)
    total = 0.0
    for _ in range(4):
        total += float(bits & _LOW16)
        bits >>= _S16
    return (total - _MEAN_OF_FOUR) / _SIGMA_OF_FOUR
