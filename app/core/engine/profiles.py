"""The profiles: each a composition of the same core blocks, its stages in order, on one screen."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from app.core.engine.blunavi2020 import (
    Blunavi2020Params,
    correct_by_ranges,
    vote_by_beacons,
    vote_by_wifi,
    walk_planar,
    widen_unseen,
)
from app.core.engine.fixing import (
    correct_particles,
    match_beacons,
    match_fingerprints,
)
from app.core.engine.grinyak2018 import (
    Grinyak2018Params,
    locate_window,
    pass_over_wifi,
)
from app.core.engine.hearing import hear_beacons, slide_window
from app.core.engine.laterating import laterate
from app.core.engine.liu2016 import (
    Liu2016Params,
    blend_scan,
    blend_stride,
    pass_over_beacons,
)
from app.core.engine.state import SessionState
from app.core.engine.tao2016 import (
    Tao2016Params,
    locate_by_beacons,
    locate_by_wifi,
    smooth_levels,
)
from app.core.engine.walking import (
    StrideRule,
    diffuse_unseen,
    find_strides,
    sense_motion,
    spread_pedometer,
    stay,
    take_phone_steps,
    walk_particles,
)
from app.core.engine.zhu2018 import Zhu2018Params, correct_scheduled, walk_scheduled
from app.core.params import Params
from app.core.site import SiteModel
from app.core.types import Barometer, BleScan, ImuBlock, Pedometer, Steps, Truth, WifiScan

Stage: TypeAlias = Callable[[SessionState, Any, SiteModel, Any], SessionState]
"""One step of an observation's way: state, observation, site and the profile's parameters."""

Stages: TypeAlias = Mapping[type, tuple[Stage, ...]]


@dataclass(frozen=True, slots=True)
class Profile:
    """A composition of core blocks under a name.

    Attributes
    ----------
    title, source
        What it is, in one line, and where it was published.
    params
        Its parameters; ``params.profile`` is its name.
    stages
        What happens to an observation of each type, in order.
    stride
        What a stride does to the track.
    reads
        Of the parameters that all profiles have, those that it reads, by block or by block and
        name. Its own blocks are there to be read.
    """

    title: str
    source: str
    params: Params
    stages: Stages
    stride: StrideRule
    reads: tuple[str, ...]

    @property
    def name(self) -> str:
        """Return the name by which sites, devices and sessions choose it."""
        return self.params.profile


MOTION: Stages = {
    ImuBlock: (sense_motion, find_strides),
    Steps: (take_phone_steps,),
    Pedometer: (spread_pedometer,),
    Barometer: (),
    Truth: (),
}
"""What motion sensors tell, the same for every profile."""

READ_BY_ALL = (
    "step",
    "floor",
    "motion_mode.step_hold_s",
    "motion_mode.walk_variance_m2ps4",
    "motion_mode.still_variance_m2ps4",
    "motion_mode.variance_time_s",
    "motion_mode.evidence_s",
    "report.silence_s",
    "report.max_age_s",
    "report.fused_s",
    "report.covariance_scale",
    "report.extra_variance_m2",
    "smoother",
)
"""What motion sensors, floors and reports read, the same for every profile."""

BEST = Profile(
    title="Candidates and lateration into a particle filter with dead reckoning",
    source="Pharos",
    params=Params(),
    stages={
        **MOTION,
        BleScan: (
            hear_beacons,
            slide_window,
            diffuse_unseen,
            match_beacons,
            correct_particles,
            laterate,
        ),
        WifiScan: (diffuse_unseen, match_fingerprints, correct_particles),
    },
    stride=walk_particles,
    reads=(
        *READ_BY_ALL,
        "match",
        "level_offset",
        "fusion",
        "lateration",
        "motion_mode",
        "report",
    ),
)

GRINYAK2018 = Profile(
    title="Windowed least squares on beacon levels, static or kinematic; no filter",
    source="Grinyak, Grinyak, Tsybanov, The Territory of New Opportunities 10(2), 2018",
    params=Grinyak2018Params(),
    stages={
        **MOTION,
        BleScan: (slide_window, locate_window),
        WifiScan: (pass_over_wifi,),
    },
    stride=stay,
    reads=(
        *READ_BY_ALL,
        "lateration.window_s",
        "lateration.phone_height_m",
        "lateration.huber_k",
        "lateration.offset_prior_db",
        "lateration.velocity_prior_mps",
        "lateration.shadowing_correlation",
        "lateration.min_anchors",
        "lateration.search_margin_m",
        "lateration.max_sigma_m",
        "motion_mode",
    ),
)

LIU2016 = Profile(
    title="Wi-Fi neighbours; speed and heading blended with the sensors'; constant-velocity filter",
    source="Liu, Jiang, Liu, Chen, Computer Science 43(1), 2016",
    params=Liu2016Params(),
    stages={
        **MOTION,
        BleScan: (pass_over_beacons,),
        WifiScan: (blend_scan,),
    },
    stride=blend_stride,
    reads=(
        *READ_BY_ALL,
        "match.max_age_s",
        "match.first_max_age_s",
        "match.min_readings",
        "fusion.sensor_gap_s",
        "report.unfixed_m2ps",
    ),
)

TAO2016 = Profile(
    title="Levels smoothed by jump-adaptive filters, nearest neighbours in a cleaned map",
    source="Tao, Yang, Wang, Zhang, Journal of Anhui Agricultural Sciences 44(8), 2016",
    params=Tao2016Params(),
    stages={
        **MOTION,
        BleScan: (smooth_levels, locate_by_beacons),
        WifiScan: (smooth_levels, locate_by_wifi),
    },
    stride=stay,
    reads=(*READ_BY_ALL, "match.wifi_gap_s", "fusion.sensor_gap_s", "report.unfixed_m2ps"),
)

ZHU2018 = Profile(
    title="Fingerprint fixes and a pedometer in a Kalman filter of scheduled variance",
    source="Zhu, Wang, Chen, Fang, Zhang, Packaging Engineering 39(5), 2018",
    params=Zhu2018Params(),
    stages={
        **MOTION,
        BleScan: (hear_beacons, match_beacons, correct_scheduled),
        WifiScan: (match_fingerprints, correct_scheduled),
    },
    stride=walk_scheduled,
    reads=(
        *READ_BY_ALL,
        "match",
        "level_offset",
        "fusion.noise_m2",
        "fusion.noise_sorensen",
        "fusion.noise_beacons_sorensen",
        "fusion.sensor_gap_s",
        "report.unfixed_m2ps",
    ),
)

BLUNAVI2020 = Profile(
    title="Votes for a reference point, an EKF on ranges in line of sight, steps between",
    source="Nguyen Ngoc Khuong, Haiphong University Journal of Science 44, 2021",
    params=Blunavi2020Params(),
    stages={
        **MOTION,
        BleScan: (hear_beacons, slide_window, widen_unseen, correct_by_ranges, vote_by_beacons),
        WifiScan: (widen_unseen, vote_by_wifi),
    },
    stride=walk_planar,
    reads=(
        *READ_BY_ALL,
        "match.max_age_s",
        "match.first_max_age_s",
        "match.min_readings",
        "match.ble_window_s",
        "match.wifi_gap_s",
        "match.wifi_start_s",
        "lateration.window_s",
        "lateration.phone_height_m",
        "fusion.sensor_gap_s",
        "fusion.sway_m2ps",
        "fusion.unseen_m2ps",
        "report.unfixed_m2ps",
    ),
)

PROFILES: dict[str, Profile] = {
    p.name: p for p in (BEST, GRINYAK2018, LIU2016, TAO2016, ZHU2018, BLUNAVI2020)
}
"""Every profile by its name."""
