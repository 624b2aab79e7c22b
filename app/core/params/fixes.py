"""Parameters of what makes fixes: lateration, fingerprint matching, the phone's level offset."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LaterationParams:
    """Windowed least squares on levels.

    Attributes
    ----------
    window_s
        Length of the window: long enough for some 28 readings per beacon, short enough that a
        walker goes straight in it (Grinyak et al. 2018).
    phone_height_m
        Height of the phone above the level that anchors' ``z_m`` counts from. With both 0 the model
        is plane, as published.
    huber_k
        Residuals beyond this many standard deviations count linearly: 1.345 keeps 95 % of the
        efficiency on normal noise (Huber 1964).
    offset_prior_db
        Standard deviation of the phone's unknown level offset, estimated along; 0: the phone is as
        calibrated. Phones differ by up to some 10 dB.
    velocity_prior_mps
        Standard deviation of each velocity component before anything is heard (kinematic model);
        None: nothing is known, as published.
    shadowing_correlation
        Correlation of the level deviations of one anchor within a window, 0 to 1. 0 is white noise,
        as published; where shadowing is fixed to the place, repeated readings tell nothing new.
    min_anchors
        Fewer anchors heard are no fix. Three determine a place; with one or two the answer is a
        neighbourhood of them, which is honest but wide.
    search_margin_m
        The phone is looked for in the box around the anchors heard, widened by this much; a third
        of it is the standard deviation of how far outside that box phones are.
    max_sigma_m
        A fix whose standard deviation in its worst direction is larger is no fix.
    correlation_m
        Shadowing errs alike over about this way (Gudmundson 1991: some metres indoors), and so do
        the fixes along it; they rest on several anchors, and forget sooner than each.
    unseen_speed_mps, still_speed_mps
        How fast shadowing changes, as if the phone moved so fast: with no sensor that would show
        its motion, and at rest, where only people around it move.
    """

    window_s: float = 2.0
    phone_height_m: float = 0.0
    huber_k: float = 1.345
    offset_prior_db: float = 0.0
    velocity_prior_mps: float | None = None
    shadowing_correlation: float = 0.0
    min_anchors: int = 3
    search_margin_m: float = 10.0
    max_sigma_m: float = 15.0
    correlation_m: float = 1.0
    unseen_speed_mps: float = 1.3
    still_speed_mps: float = 0.01


@dataclass(frozen=True, slots=True)
class MatchParams:
    """Fingerprint matching.

    Attributes
    ----------
    max_age_s
        Wi-Fi readings measured longer ago are dropped: phones report a scan every 2 s and repeat
        cached results for a minute (ms2020: 2.5 s is better than 4 by 3 %).
    first_max_age_s
        The same for a session's first fix, where an old neighbourhood beats no place at all.
    min_readings
        Fewer fresh readings than this say too little to be a fingerprint or a query.
    ble_window_s
        Advertisements of this long are averaged: about ten at 3 to 5 Hz, 4 m at walking pace.
    wifi_gap_s, wifi_start_s
        A phone that scanned Wi-Fi this lately, or began this lately, waits for its next scan: BLE
        alone tells less (ms2020: 11 m at a walk's first seconds, and not always the floor).
    wifi_floor_dbm, ble_floor_dbm
        Level that counts as not heard; just under what phones report at the weakest.
    sorensen_exponent, cosine_exponent, ble_exponent
        Exponents of the representation; > 1 lets near transmitters decide (flat between 2 and 3 on
        ms2020; scans of many phone models match best with 2).
    ble_gain
        Weight of the BLE distance against the two Wi-Fi ones (ms2020: 2 % better than without).
    k
        Candidates kept.
    softness_ratio
        Scale of the softmax over distances, as a share of the nearest Sørensen distance.
    virtual_gain, virtual_even_share
        How much nearer virtual fingerprints count the less the map knows of a scan, and where they
        count as others do (ms2020: 1 %, with a quarter of its map 2 %).
    crowd_m
        Fingerprints within this distance of each other share their weight (ms2020: 1 % better;
        flat from 3 to 4).
    max_sorensen
        Where even the nearest fingerprint shares less than 3 % of what is heard, the phone is not
        in the mapped area.
    """

    max_age_s: float = 2.5
    first_max_age_s: float = 10.0
    min_readings: int = 3
    ble_window_s: float = 3.0
    wifi_gap_s: float = 8.0
    wifi_start_s: float = 3.0
    wifi_floor_dbm: float = -100.0
    ble_floor_dbm: float = -105.0
    sorensen_exponent: float = 2.0
    cosine_exponent: float = 2.0
    ble_exponent: float = 2.0
    ble_gain: float = 0.3
    k: int = 25
    softness_ratio: float = 0.2
    virtual_gain: float = 0.2
    virtual_even_share: float = 0.4
    crowd_m: float = 4.2
    max_sorensen: float = 0.97


@dataclass(frozen=True, slots=True)
class LevelOffsetParams:
    """The phone's level offset against the map (see `app.core.fingerprint.level_offset`).

    Fitted on ms2020 (folds 1 to 3) with 10 dB added and taken off: the error stays within 6 % of
    the phone's own, where it was a fifth higher, and does not grow with nothing added.

    Attributes
    ----------
    prior_db
        Deviation of phones' levels from the survey's.
    noise_db, walk_db2
        Deviation of one scan's median residual from the offset, and how much the offset's variance
        grows per scan: a hand about the phone comes and goes.
    tried_db
        Offsets with which a session's first scan is matched.
    least_dbm
        Weaker levels tell nothing: what is heard there is what fading happened to lift. Above, a
        phone that hears less would lose too many.
    min_transmitters
        Fewer tell no median.
    """

    prior_db: float = 6.0
    noise_db: float = 5.0
    walk_db2: float = 0.5
    tried_db: tuple[float, ...] = (-8.0, 0.0, 8.0)
    least_dbm: float = -90.0
    min_transmitters: int = 4
