"""Parameters of what follows a phone: filter, smoother, floors, and what is said of them."""

from dataclasses import dataclass


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
        Variance of candidates about the truth: noise (1 + q noise_sorensen D1⁴), D1 the Sørensen
        distance of the nearest fingerprint (0.1 to 0.3 on a good map), q the map's own (about 1,
        see `app.core.engine.match_noise`).
    noise_beacons_sorensen
        The same where only advertisements were matched, times D1²: few beacons resemble many
        places.
    clutter
        Likelihood per m² of candidates that have nothing to do with the place.
    tempering
        Power of a scan's likelihood; successive scans are not independent.
    off_floor_weight, leave_floor_weight, far_off_m
        Log weight lost per step and metre off the walkable floor, and per metre farther off it;
        beyond ``far_off_m`` nothing more is lost: plans are not exact.
    way_weight
        Log weight per step of what the ways say against a particle's direction; steps go on as
        they began, so one tells little that the one before did not.
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
    noise_sorensen: float = 156.0
    noise_beacons_sorensen: float = 60.0
    clutter: float = 3e-5
    tempering: float = 0.45
    off_floor_weight: float = 0.05
    leave_floor_weight: float = 0.4
    far_off_m: float = 4.0
    way_weight: float = 0.06
    jitter_share: float = 0.3
    jitter_max_m: float = 1.0
    bias_jitter_share: float = 0.1
    birth_share: float = 0.005
    sensor_gap_s: float = 3.0
    sway_m2ps: float = 0.002
    unseen_m2ps: float = 1.0


@dataclass(frozen=True, slots=True)
class SmootherParams:
    """Smoothing of a finished track; fitted on ms2020 (folds 1 to 3).

    Attributes
    ----------
    tempering, way_weight
        As in `FusionParams`, for particles that follow the walk from both its ends: each scan
        counts twice, and what is known from there leaves more to the ways.
    both_ways_share
        Share of their path in the track, the rest is the Kalman smoother's: on real walks 3 %
        better than either (flat from a third to six tenths), on simulated ones 6 % worse than the
        latter.
    passes
        Each weighs candidates by the path of the one before; more gain nothing.
    start_m
        Spread of the first place about the guess: nothing is known of it.
    bias_prior_rad, bias_walk_rad, scale_prior, along_m, cross_m
        As in `FusionParams`, for a filter that is normal: wider, in place of its heavy tails.
    noise_ratio
        Covariance of a sighting over that of the filter, which keeps single candidates apart.
    gate_m2
        Added to the path's covariance when it weighs candidates.
    off_floor_m, pull_m
        A path this far off the walkable floor (a raster cell) is drawn to it with this deviation:
        people lean into shops, and plans are not exact.
    slope_step_m, least_slope_ratio
        The way to the floor is the slope of the distance raster over this step; where it is flatter
        than this (a ridge between two corridors) neither side is right.
    covariance_scale, sighted_share, extra_variance_m2
        As in `ReportParams`, for smoothed points: with a quarter of ms2020's map 93 % of the truth
        lie within their radius (without the share 74 %), with all of it 96 %. Where anchors told
        the place there is no share.
    """

    tempering: float = 0.3
    way_weight: float = 0.12
    both_ways_share: float = 0.5
    passes: int = 4
    start_m: float = 50.0
    bias_prior_rad: float = 0.28
    bias_walk_rad: float = 0.07
    scale_prior: float = 0.15
    along_m: float = 0.35
    cross_m: float = 0.2
    noise_ratio: float = 16.0
    gate_m2: float = 10.0
    off_floor_m: float = 0.5
    pull_m: float = 2.0
    slope_step_m: float = 1.0
    least_slope_ratio: float = 0.6
    covariance_scale: float = 0.4
    sighted_share: float = 0.8
    extra_variance_m2: float = 3.0


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
    covariance_scale, sighted_share, extra_variance_m2
        Reported covariance = scale P + share R + extra on each axis, R the last scan's. Errors have
        heavier tails than the cloud of particles; scans of one place err alike, so they do not
        average out as it takes them to; and map and truth have errors of their own. Fitted on
        ms2020's tuning walks with all of the map, half and a quarter: 94 to 97 % of the truth
        within ``radius95_m``, in every decile of the radius 86 % or more (without the share 93 %
        and 84 % on thin maps, no narrower on full ones).
    laterated_s, laterated_scale, laterated_extra_m2
        The same where anchors have told the place within so many seconds: a fix's covariance says
        how it errs and for how long alike, and anchors are surveyed better than maps. Chosen on
        walks through the made-up warehouse; on real ones with beacons it has yet to be seen.
    unfixed_m2ps
        Once a point is dead reckoning, what each axis' variance has grown per second since the last
        fix in which the phone may have moved. 0: the filter widens itself.
    """

    silence_s: float = 10.0
    max_age_s: float = 60.0
    fused_s: float = 10.0
    covariance_scale: float = 1.8
    sighted_share: float = 0.4
    extra_variance_m2: float = 3.0
    laterated_s: float = 5.0
    laterated_scale: float = 3.0
    laterated_extra_m2: float = 0.25
    unfixed_m2ps: float = 0.0
