"""Accelerometer recordings with true step counts (Oxford step counter data set).

One gzipped CSV per recording, without a header: time since boot (ns), acceleration along three axes
(m/s²), and cumulative step counts of three counters; the second one is the ground truth.
"""

import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.core.types import ImuBlock

_SUFFIX = ".csv.gz"
_NS_PER_S = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class StepRecording:
    """One walk with the phone in one place.

    ``carried`` is where it was (hand, frontpocket ...); ``true_steps`` what was counted.
    """

    name: str
    carried: str
    blocks: tuple[ImuBlock, ...]
    true_steps: int


def recording_paths(folder: Path) -> list[Path]:
    """Return the recordings of a folder, by name."""
    return sorted(path for path in folder.iterdir() if path.name.endswith(_SUFFIX))


def read_recording(path: Path) -> StepRecording:
    """Read one recording; its samples come in blocks cut at whole seconds, as phones post them.

    Raises
    ------
    ValueError
        If the file is not of this format; the message names it.
    """
    name = path.name.removesuffix(_SUFFIX)
    try:
        with gzip.open(path, "rt", encoding="ascii") as lines:
            rows = np.loadtxt(lines, delimiter=",", ndmin=2)
        carried = name.split("_")[1]
        time_s, acc_mps2, counts = rows[:, 0] / _NS_PER_S, rows[:, 1:4], rows[:, 5]
    except (OSError, EOFError, ValueError, IndexError) as error:
        msg = f"{path.name}: not a step recording ({error})"
        raise ValueError(msg) from error
    second = np.floor(time_s)
    blocks = (_block(time_s[second == k], acc_mps2[second == k]) for k in np.unique(second))
    return StepRecording(
        name, carried, tuple(b for b in blocks if b is not None), int(counts[-1] - counts[0])
    )


def _block(time_s: np.ndarray, acc_mps2: np.ndarray) -> ImuBlock | None:
    if len(time_s) < 2:
        return None
    empty = np.empty((0, 3), dtype=np.float32)
    return ImuBlock(
        time_s=float(time_s[0]),
        rate_hz=(len(time_s) - 1) / float(time_s[-1] - time_s[0]),
        acc_mps2=acc_mps2.astype(np.float32),
        gyro_radps=empty,
        mag_ut=empty,
        quat_wxyz=np.empty((0, 4), dtype=np.float32),
    )
