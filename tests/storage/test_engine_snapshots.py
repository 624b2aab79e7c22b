"""A snapshot of a real fold, written and read again, has the same future, bit for bit."""

import pytest

from app.core.engine import PROFILES, SessionState, advance, explained, finish, start
from app.core.simulate import walk, warehouse
from app.storage.codec import TreeCodec


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("imu", [False, True], ids=["phone steps", "imu"])
def test_a_restored_state_has_the_same_future(imu, profile):
    world = warehouse(4)
    observations = walk(world, 2, start_s=1_700_000_000.0, duration_s=30.0, imu=imu).observations
    codec, params = TreeCodec(SessionState), PROFILES[profile].params
    state = restored = start()
    for i, observation in enumerate(observations):
        if i % 7 == 0:
            restored = codec.decode(codec.encode(restored))
        state, outputs = advance(state, observation, world.site, params)
        restored, again = advance(restored, observation, world.site, params)
        assert again == outputs
    ended = finish(state, world.site, params)
    assert finish(restored, world.site, params) == ended
    assert explained(restored, world.site, params) == explained(state, world.site, params)
    assert codec.encode(restored) == codec.encode(state)
