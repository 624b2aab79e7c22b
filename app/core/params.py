"""Parameters of the engine: physics and choices, each with unit, reason and source."""

from dataclasses import dataclass, field


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
class MotionModeParams:
    """When a phone counts as walking.

    Every pair of bounds is a hysteresis: above the first walking begins, below the second it ends.

    Attributes
    ----------
    step_hold_s
        A step speaks for this long: longer than the slowest usual step interval (about 1.2 s).
    walk_variance_m2ps4, still_variance_m2ps4
        Variance of the norm of the acceleration. Walking gives 2 to 10, a hand that holds a phone
        about 0.05, a table below 0.005.
    variance_time_s
        Time constant of the running variance: about one step. With two the end of a walk is noticed
        over 2 s late, later than a window lasts.
    walk_chi2, still_chi2
        ``v' D_vv^-1 v`` of the kinematic model: at rest chi-square with two degrees of freedom, so
        9.21 is passed by 1 % of windows and 4.61 by 10 %.
    evidence_s
        Older evidence of a kind is as good as none.
    """

    step_hold_s: float = 1.5
    walk_variance_m2ps4: float = 0.8
    still_variance_m2ps4: float = 0.25
    variance_time_s: float = 0.5
    walk_chi2: float = 9.21
    still_chi2: float = 4.61
    evidence_s: float = 4.0


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
        Exponents of the representation; > 1 lets near transmitters decide (flat between 2 and 3).
    ble_gain
        Weight of the BLE distance against the two Wi-Fi ones (ms2020: 2 % better than without).
    k
        Candidates kept.
    softness
        Scale of the softmax over distances.
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
    sorensen_exponent: float = 2.5
    cosine_exponent: float = 2.5
    ble_exponent: float = 2.0
    ble_gain: float = 0.3
    k: int = 15
    softness: float = 0.07
    max_sorensen: float = 0.97


@dataclass(frozen=True, slots=True)
class LevelOffsetParams:
    """The phone's level offset against the map (see `app.core.fingerprint.level_offset`).

    Fitted on ms2020 (folds 1 to 3) with 10 dB added and taken off: the error stays within 5 % of
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
        Weaker levels tell nothing: what is heard there is what fading happened to lift.
    min_transmitters
        Fewer tell no median.
    """

    prior_db: float = 6.0
    noise_db: float = 5.0
    walk_db2: float = 0.5
    tried_db: tuple[float, ...] = (-12.0, -6.0, 0.0, 6.0, 12.0)
    least_dbm: float = -85.0
    min_transmitters: int = 4


@dataclass(frozen=True, slots=True)
class StepParams:
    """Steps from the accelerometer, and how long they are.

    Attributes
    ----------
    lowpass_hz
        Steps come at up to 2 Hz indoors; faster is shaking, heel strike and the second swing that a
        leg gives to a pocket (3 Hz counts 10 % too many in a back pocket, 2 Hz none; on the tuning
        walks of ms2020 the error is 2 % lower).
    mean_time_s
        Time constant of the mean that is taken off (gravity and slow posture).
    rise_mps2
        A step's swing must rise this far over the mean; less is fidgeting.
    min_interval_s
        Nobody steps faster.
    pause_s, cadence_hz
        After a longer interval the cadence is unknown and this one, usual indoors, is assumed.
    length_coefficients
        Step length = c0 + c1 A + c2 f + c3 A f, A = (peak - valley)^(1/4) (Weinberg 2002),
        f = cadence; fitted between waypoints of ms2020 map walks. In a new site it is a prior and
        the filter's scale does the rest.
    min_length_m, max_length_m
        Bounds of an adult's indoor step.
    usual_length_m
        Of steps that the phone only counts.
    """

    lowpass_hz: float = 2.0
    mean_time_s: float = 1.0
    rise_mps2: float = 0.45
    min_interval_s: float = 0.28
    pause_s: float = 1.5
    cadence_hz: float = 1.8
    length_coefficients: tuple[float, float, float, float] = (-1.98, 2.03, 0.894, -0.748)
    min_length_m: float = 0.2
    max_length_m: float = 1.1
    usual_length_m: float = 0.66


@dataclass(frozen=True, slots=True)
class FusionParams:
    """The particle filter over (x, y, heading bias, step scale).

    Fitted together on ms2020 (folds 1 to 3 against maps of the other two); the error is flat within
    2 % over a factor of 2 in most of them.

    Attributes
    ----------
    particles
        Their number; 1000 instead of 300 gain nothing that can be seen on real walks.
    bias_prior_rad, bias_walk_rad
        Angle between phone and walking direction: its spread over walks (10 to 14 degrees for a
        phone held in the hand, some for the building's own frame), and its change per step.
    scale_prior, scale_walk
        Spread of a person's step length over the modelled one, and its change per step.
    length_noise_ratio, heading_noise_rad
        Error of one step's length and direction; larger than the sensors' own, since successive
        scans err alike and must not be averaged for too long.
    noise_m2, noise_sorensen
        Variance of candidates about the truth: noise (1 + noise_sorensen D1²), D1 the Sørensen
        distance of the nearest fingerprint (0.1 to 0.3 on a good map).
    noise_beacons_m2
        The same where only advertisements were matched: a few beacons tell a neighbourhood.
    clutter
        Likelihood per m² of candidates that have nothing to do with the place.
    tempering
        Power of a scan's likelihood; successive scans are not independent.
    off_floor_weight, leave_floor_weight, far_off_m
        Log weight lost per step and metre off the walkable floor, and per metre farther off it;
        beyond ``far_off_m`` nothing more is lost: plans are not exact.
    jitter_share, jitter_max_m, bias_jitter_share
        How far a resampled copy moves, as a share of the cloud's spread, and at most.
    birth_share
        Share of particles that each scan starts anew.
    sensor_gap_s
        After so long without inertial samples their silence no longer means standing still.
    sway_m2ps, unseen_m2ps
        Growth of the variance with time when the sensors show no step, and when there is no sensor:
        1 m²/s is a walker who turns at random every other second.
    """

    particles: int = 300
    bias_prior_rad: float = 0.22
    bias_walk_rad: float = 0.04
    scale_prior: float = 0.05
    scale_walk: float = 0.005
    length_noise_ratio: float = 0.1
    heading_noise_rad: float = 0.3
    noise_m2: float = 5.0
    noise_sorensen: float = 20.0
    noise_beacons_m2: float = 60.0
    clutter: float = 3e-4
    tempering: float = 0.45
    off_floor_weight: float = 0.05
    leave_floor_weight: float = 1.0
    far_off_m: float = 4.0
    jitter_share: float = 0.2
    jitter_max_m: float = 0.6
    bias_jitter_share: float = 0.1
    birth_share: float = 0.01
    sensor_gap_s: float = 3.0
    sway_m2ps: float = 0.002
    unseen_m2ps: float = 1.0


@dataclass(frozen=True, slots=True)
class SmootherParams:
    """Smoothing of a finished track; fitted on ms2020 (folds 1 to 3).

    Attributes
    ----------
    passes
        Each weighs candidates by the path of the one before; more gain nothing.
    start_m
        Spread of the first place about the guess: nothing is known of it.
    bias_prior_rad, bias_walk_rad, scale_prior, along_m, cross_m
        As in `FusionParams`, for a filter that is normal: wider, in place of its heavy tails.
    noise_ratio
        Covariance of a sighting over that of the filter, which keeps single candidates apart.
    student_dof
        Degrees of freedom of the Student weight: errors of fixes have heavy tails.
    gate_m2
        Added to the path's covariance when it weighs candidates.
    off_floor_m, pull_m
        A path this far off the walkable floor (a raster cell) is drawn to it with this deviation:
        people lean into shops, and plans are not exact.
    slope_step_m, least_slope_ratio
        The way to the floor is the slope of the distance raster over this step; where it is flatter
        than this (a ridge between two corridors) neither side is right.
    covariance_scale, extra_variance_m2
        As in `ReportParams`, for smoothed points.
    """

    passes: int = 8
    start_m: float = 50.0
    bias_prior_rad: float = 0.28
    bias_walk_rad: float = 0.07
    scale_prior: float = 0.15
    along_m: float = 0.35
    cross_m: float = 0.2
    noise_ratio: float = 16.0
    student_dof: float = 8.0
    gate_m2: float = 10.0
    off_floor_m: float = 0.5
    pull_m: float = 2.0
    slope_step_m: float = 1.0
    least_slope_ratio: float = 0.6
    covariance_scale: float = 0.6
    extra_variance_m2: float = 18.0


@dataclass(frozen=True, slots=True)
class FloorParams:
    """Belief in floors.

    Attributes
    ----------
    change_rate_ps
        Floor changes per second: one in three minutes. It bounds how sure the belief gets, so that
        a few votes turn it after the stairs.
    vote_floor
        Share of a vote that any floor gets, for candidates that happen to look alike.
    trust
        Power of a vote; successive scans are not independent.
    least_s
        Scans closer together leak as if this far apart: the belief stays movable.
    """

    change_rate_ps: float = 0.005
    vote_floor: float = 0.05
    trust: float = 0.7
    least_s: float = 0.5


@dataclass(frozen=True, slots=True)
class ReportParams:
    """What is said of the filter's state.

    Attributes
    ----------
    silence_s
        Whole seconds are reported for this long after the phone's last word.
    max_age_s
        With no scan for longer the place is not known any more.
    fused_s
        Older than this, a scan no longer makes a point "fused": it is dead reckoning.
    covariance_scale, extra_variance_m2
        Reported covariance = scale P + extra on each axis. Errors have heavier tails than the
        cloud of particles, and map and truth have errors of their own that it cannot know. Fitted
        on ms2020's tuning walks: 95 % of the truth within ``radius95_m``, in every decile of the
        radius over 90 %.
    laterated_s, laterated_scale, laterated_extra_m2
        The same where anchors have told the place within so many seconds: a fix's covariance says
        how it errs and for how long alike, and anchors are surveyed better than maps. Chosen on
        walks through the made-up warehouse; on real ones with beacons it has yet to be seen.
    """

    silence_s: float = 10.0
    max_age_s: float = 60.0
    fused_s: float = 10.0
    covariance_scale: float = 2.0
    extra_variance_m2: float = 7.5
    laterated_s: float = 5.0
    laterated_scale: float = 3.0
    laterated_extra_m2: float = 0.25


def _best_lateration() -> LaterationParams:
    """Return what live phones need: their level offset is unknown, shadowing stays where it is."""
    return LaterationParams(offset_prior_db=5.0, shadowing_correlation=1.0, velocity_prior_mps=1.2)


@dataclass(frozen=True, slots=True)
class Params:
    """Parameters of a profile; a published one adds its own.

    Attributes
    ----------
    level_offset
        None: levels count as the phone tells them.
    smoother
        None: the system has no smoother, what is stored is its causal track.
    """

    profile: str = "best"
    match: MatchParams = field(default_factory=MatchParams)
    level_offset: LevelOffsetParams | None = field(default_factory=LevelOffsetParams)
    step: StepParams = field(default_factory=StepParams)
    fusion: FusionParams = field(default_factory=FusionParams)
    floor: FloorParams = field(default_factory=FloorParams)
    report: ReportParams = field(default_factory=ReportParams)
    smoother: SmootherParams | None = field(default_factory=SmootherParams)
    lateration: LaterationParams = field(default_factory=_best_lateration)
    motion_mode: MotionModeParams = field(default_factory=MotionModeParams)
