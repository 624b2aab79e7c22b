"""docs/calibration.md says what the code says, and its bodies are valid."""

import re
from pathlib import Path

from app.api.calibrations import Source
from app.services import beacon_calibration, beacon_placing

PAGE = (Path(__file__).parents[2] / "docs" / "calibration.md").read_text(encoding="utf-8")


def warnings_of(heading: str) -> set[str]:
    table = PAGE.partition(heading)[2].partition("| warning |")[2].partition("\n\n")[0]
    return set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE))


def test_every_warning_is_explained() -> None:
    assert warnings_of("## Draft") == {
        beacon_calibration.NEVER_HEARD,
        beacon_calibration.LEVEL_FROM_MEAN,
        beacon_calibration.EXPONENT_FROM_MEAN,
        beacon_calibration.NO_BETTER_THAN_MEAN,
        beacon_calibration.EXPONENT_AT_BOUND,
    }
    assert warnings_of("## Beacons whose place") == {
        beacon_placing.TOO_FEW_LEVELS,
        beacon_placing.WIDE,
        beacon_placing.AT_THE_EDGE,
    }


def test_the_bodies_shown_are_valid() -> None:
    shown = re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)
    shown += re.findall(r"-d '(.*?)'", PAGE, re.DOTALL)
    assert len(shown) == 2
    for body in shown:
        Source.model_validate_json(body)


def test_the_bounds_told_are_those_of_the_code() -> None:
    assert f"fewer than {beacon_placing.FEW_LEVELS} places" in PAGE
    assert f"worse than {beacon_placing.WIDE_SIGMA_M:g} m" in PAGE
    assert beacon_calibration.MIN_LEVELS == 30
    assert "thirty levels" in PAGE
