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
    """

    title: str
    source: str
    params: Params
    stages: Stages
    stride: StrideRule

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
)

PROFILES: dict[str, Profile] = {
    p.name: p for p in (BEST, GRINYAK2018, LIU2016, TAO2016, ZHU2018, BLUNAVI2020)
}
"""Every profile by its name."""
