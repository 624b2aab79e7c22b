"""Recordings as other phones would have posted them."""

from app.core.types import BleScan, Reading, Steps, WifiScan
from app.services.evaluation.phones import PHONES, THROTTLED_PERIOD_S

WALK = [
    observation
    for second in range(65)
    for observation in (
        BleScan(float(second), (Reading(("b",), -70.0),)),
        Steps(second + 0.3, 1),
        WifiScan(second + 0.5, (Reading(("w",), -60.0, 0.4),)),
    )
]


def wifi_times(observations):
    return [o.time_s for o in observations if isinstance(o, WifiScan)]


def test_the_recorded_phone_posts_what_was_recorded():
    assert PHONES["recorded"](WALK) == tuple(WALK)


def test_an_iphone_posts_no_wifi_and_all_else():
    posted = PHONES["iphone"](WALK)
    assert wifi_times(posted) == []
    assert len(posted) == 2 * len(WALK) // 3


def test_a_throttled_phone_posts_its_first_scan_and_then_one_in_thirty_seconds():
    posted = PHONES["throttled"](WALK)
    assert wifi_times(posted) == [0.5, 0.5 + THROTTLED_PERIOD_S, 0.5 + 2 * THROTTLED_PERIOD_S]
    assert len(posted) == len(WALK) - 65 + 3


def test_a_louder_and_a_weaker_phone_hear_10_db_more_and_less():
    for name, offset_db in (("louder", 10.0), ("weaker", -10.0)):
        ble, steps, wifi = PHONES[name](WALK)[:3]
        assert isinstance(ble, BleScan)
        assert isinstance(wifi, WifiScan)
        assert ble.readings[0].rssi_dbm == -70.0 + offset_db
        assert wifi.readings[0] == Reading(("w",), -60.0 + offset_db, 0.4)
        assert steps == WALK[1]
