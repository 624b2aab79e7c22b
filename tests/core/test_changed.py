"""Values with some fields changed."""

import pytest

from app.core.changed import changed
from app.core.motion.mode import MotionState


def test_changed_leaves_the_value_and_its_other_fields_alone() -> None:
    before = MotionState(velocity_chi2=3.0)
    after = changed(before, last_step_s=5.0)
    assert before == MotionState(velocity_chi2=3.0)
    assert after == MotionState(velocity_chi2=3.0, last_step_s=5.0)


def test_changed_knows_no_other_fields() -> None:
    with pytest.raises(TypeError, match="MotionState has no heading_rad"):
        changed(MotionState(), heading_rad=1.0)
