"""Step counts: the step detector on recordings with the phone carried in six ways."""

from collections.abc import Iterable

import numpy as np

from app.core.motion.steps import StepDetector, detect_steps
from app.core.params import StepParams
from app.formats.oxford_steps import StepRecording
from app.services.evaluation.figures import Evaluation

PROTOCOL = (
    "the step detector as it is, causal, in blocks of one second; per recording "
    "|counted - true| / true over the whole of it"
)


def evaluate(recordings: Iterable[StepRecording]) -> Evaluation:
    """Return the errors of the step counts, the mean and the worst and each."""
    params = StepParams()
    errors = {
        recording.carried: abs(count_steps(recording, params) / recording.true_steps - 1.0)
        for recording in recordings
    }
    shares = np.array(list(errors.values()))
    figures = {
        "traces": len(errors),
        "mean_count_error_share": float(shares.mean()),
        "worst_count_error_share": float(shares.max()),
        "count_error_share_by_place": errors,
    }
    return Evaluation(
        "oxford-steps", "pharos evaluate oxford-steps DIR", PROTOCOL, {"steps": figures}
    )


def count_steps(recording: StepRecording, params: StepParams) -> int:
    """Return how many steps the detector finds in a recording."""
    detector, count = StepDetector(), 0
    for block in recording.blocks:
        detector, steps = detect_steps(detector, block, params)
        count += len(steps)
    return count
