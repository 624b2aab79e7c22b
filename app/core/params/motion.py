"""Parameters of what tells motion: its mode, steps and their length."""

from dataclasses import dataclass


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
