"""The profiles are shown as they are in the code: each parameter, its unit, what it means."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest

from app.core.engine import PROFILES
from app.core.params import Params
from app.services.errors import AppError
from app.services.profiles import (
    ParameterGroup,
    ParameterView,
    ProfileView,
    attribute_meanings,
    find_profile,
    list_profiles,
    unit_of,
)


def flat(part: ProfileView | ParameterGroup, path: str = "") -> Iterator[tuple[str, ParameterView]]:
    for parameter in part.parameters:
        yield path + parameter.name, parameter
    for group in part.groups:
        yield from flat(group, f"{path}{group.name}.")


@pytest.mark.parametrize("name", sorted(PROFILES))
def test_a_parameter_is_shown_with_its_value_and_meaning(name: str) -> None:
    shown = dict(flat(find_profile(name)))
    blocks = {"": PROFILES[name].params}
    count = 0
    while blocks:
        path, block = blocks.popitem()
        for declared in dataclasses.fields(block):
            value = getattr(block, declared.name)
            if dataclasses.is_dataclass(value):
                blocks[f"{path}{declared.name}."] = value
            elif path + declared.name in shown:
                one = shown[path + declared.name]
                assert one.value == (list(value) if isinstance(value, tuple) else value)
                assert one.description, f"{path}{declared.name} says nothing of itself"
                count += 1
    assert len(shown) == count
    assert PROFILES[name].title
    assert PROFILES[name].source


def test_profiles_are_listed_by_name() -> None:
    assert [profile.name for profile in list_profiles()] == sorted(PROFILES)
    with pytest.raises(AppError, match="there is no profile 'none'"):
        find_profile("none")


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("window_s", "s"),
        ("noise_m2", "m²"),
        ("sway_m2ps", "m²/s"),
        ("still_variance_m2ps4", "m²/s⁴"),
        ("velocity_prior_mps", "m/s"),
        ("turn_radps", "rad/s"),
        ("change_rate_ps", "1/s"),
        ("wifi_floor_dbm", "dBm"),
        ("usual_loss_db", "dB"),
        ("bias_prior_rad", "rad"),
        ("lowpass_hz", "Hz"),
        ("huber_k", ""),
        ("walk_chi2", ""),
        ("trust", ""),
        ("births", ""),
        ("s", ""),
    ],
)
def test_the_unit_is_what_the_name_ends_in(name: str, unit: str) -> None:
    assert unit_of(name) == unit


@dataclass(frozen=True, slots=True)
class _Turns:
    """Turns of a walker.

    Attributes
    ----------
    rate_radps, pause_s : float
        Fastest turn, and how long
        it lasts.

    Notes
    -----
    rate_radps
        Not this.
    """

    rate_radps: float = 2.0
    pause_s: float = 0.5


@dataclass(frozen=True, slots=True)
class _TurningParams(Params):
    """A profile of its own.

    Attributes
    ----------
    gain : (2,)
        Of ``turns``.
    """

    gain: tuple[float, float] = (0.5, float("inf"))
    turns: _Turns = field(default_factory=_Turns)


def test_a_new_block_shows_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    params = _TurningParams(profile="turning", smoother=None)
    turning = dataclasses.replace(PROFILES["best"], title="T", source="S", params=params)
    monkeypatch.setitem(PROFILES, "turning", turning)
    shown = find_profile("turning")
    own = {path: one for path, one in flat(shown) if path.startswith(("gain", "turns", "smoo"))}
    turn = "Fastest turn, and how long it lasts."
    assert own == {
        "gain": ParameterView("gain", [0.5, "inf"], "", "Of turns."),
        "turns.rate_radps": ParameterView("rate_radps", 2.0, "rad/s", turn),
        "turns.pause_s": ParameterView("pause_s", 0.5, "s", turn),
        "smoother": ParameterView("smoother", None, "", attribute_meanings(Params)["smoother"]),
    }
    groups = {group.name: group.description for group in shown.groups}
    assert groups["turns"] == "Turns of a walker"
