"""List the faults that data can have, with the limit, the effect and the remedy of each."""

from __future__ import annotations

from typing import Literal, NamedTuple

from tvsysid.recordings.plausible import MAX_ANGLE_RMS_RAD, MAX_STANDSTILL_S


class Fault(NamedTuple):
    """One fault that data can have, and its limit.

    Parameters
    ----------
    title, measure, effect, remedy
        In words: what it is, what its value is, what it does to the result, and what to do.
    limit, unit
        Value that is still in order.
    wrong
        On which side of the limit a value is wrong; above, the sign does not count.
    lowest
        Value below which it is wrong too, where that has two sides.
    """

    title: str
    measure: str
    limit: float
    unit: str
    effect: str
    remedy: str
    wrong: Literal["above", "below"] = "above"
    lowest: float = 0.0

    def beyond(self, value: float) -> bool:
        """Whether a value is on the wrong side of the limit."""
        if self.wrong == "below":
            return value < self.limit
        return abs(value) > self.limit or abs(value) < self.lowest


# By name, in the order in which they are reported.
FAULTS: dict[str, Fault] = {
    "few-realizations": Fault(
        "Few realizations",
        "realizations",
        15,
        "realizations",
        "the random error falls with the square root of their number; methods that look at each "
        "time by itself need "
        "more of them than they have lags",
        "record more, or cut shorter realizations if the behaviour repeats more often",
        "below",
    ),
    "weak-answer": Fault(
        "The torque hardly responds to the angle",
        "share of the torque that stiffness, viscosity and inertia explain",
        30,
        "%",
        "the random error of the stiffness is large",
        "perturb more strongly, record more realizations, and see whether these are the right two "
        "channels, and "
        "whether every realization was perturbed anew",
        "below",
    ),
    "narrow-excitation": Fault(
        "The perturbation leaves impedance undetermined",
        "standard error of the mean stiffness or inertia, whichever is worse, over its value",
        20,
        "%",
        "stiffness, viscosity and inertia are not separately identifiable, and none of them can "
        "be trusted",
        "use a perturbation with power from below 2 Hz to above the joint's natural frequency, "
        "some 10 Hz at the ankle",
    ),
    "same-perturbation": Fault(
        "The same perturbation in every realization",
        "share of the angle's variance that is common to all realizations, or white as sensor "
        "noise is",
        30,
        "%",
        "a response to the angle cannot be separated from what repeats anyway; once the mean is "
        "subtracted, only "
        "noise is left",
        "draw a new random perturbation for every realization; data recorded like this cannot be "
        "repaired",
    ),
    "repeated-realizations": Fault(
        "Realizations are repeated",
        "realizations whose angle and torque are copies of another one",
        0,
        "realizations",
        "the same noise counts as if it were measured again: bands and random errors come out too "
        "small",
        "keep one of each (ensemble.select), and check whether a file was read twice",
    ),
    "mean-torque": Fault(
        "A mean torque is left",
        "RMS of the torque's mean over realizations against what chance leaves",
        2.5,
        "times",
        "the voluntary or passive torque that all realizations share is taken for an answer to "
        "the angle, and biases "
        "the stiffness",
        "ensemble = tv.preprocess.subtract_mean(ensemble)",
    ),
    "mean-angle": Fault(
        "A mean angle is left",
        "RMS of the angle's mean over realizations against what chance leaves",
        2.5,
        "times",
        "an offset or an imposed movement counts as perturbation, and biases the stiffness",
        "ensemble = tv.preprocess.subtract_mean(ensemble)",
    ),
    "same-channel": Fault(
        "Angle and torque are one signal",
        "correlation of angle and torque, without its sign",
        99.99,
        "%",
        "the result is the factor between the two signals, and no impedance",
        "check which channels were named as angle and as torque (--angle, --torque)",
    ),
    "reversed-torque": Fault(
        "The torque has the opposite sign",
        "mean stiffness",
        0,
        "N·m/rad",
        "stiffness, viscosity and inertia all come out negative",
        "read the file with torque_sign=-1 (--torque-sign -1)",
        "below",
    ),
    "angle-unit": Fault(
        "The angle is too large for radians",
        "RMS of the angle about its mean over realizations",
        MAX_ANGLE_RMS_RAD,
        "rad",
        "degrees taken for radians make stiffness, viscosity and inertia 57 times too small; if "
        "they are radians, no "
        "joint is linear over such a wide movement",
        "if the file is in degrees, read it with angle_unit='deg' (--angle-unit deg); if this is "
        "the torque, name the"
        " channels the other way round",
    ),
    "torque-unit": Fault(
        "Stiffer or softer than any joint",
        "mean stiffness, without its sign",
        1500,
        "N·m/rad",
        "stiffness, viscosity and inertia are wrong by the same factor",
        "convert the torque to N·m if it is in mN·m, N·cm or kN·m, do not read radians as "
        "degrees, and do not swap the "
        "channels",
        lowest=0.2,
    ),
    "sampling-rate": Fault(
        "Too slow or too fast for a joint",
        "natural frequency, in octaves from the middle of the range of joints (1 to 40 Hz; "
        "inertia up to 1 kg·m²)",
        2.66,
        "octaves",
        "a rate that is stated too high by a factor makes viscosity too small by that factor, and "
        "inertia by its "
        "square",
        "check at what rate the file was sampled; the inertia of foot and footplate is 0.01 to "
        "0.04 kg·m²",
    ),
    "delay": Fault(
        "Angle and torque are not recorded at the same time",
        "delay of the torque",
        0.75,
        "ms",
        "a torque that is late by d takes viscosity times d from the inertia (a tenth of it for 1 "
        "ms at the ankle) and "
        "stiffness times d from the viscosity, and distorts the rest; an early one adds as much",
        "find what delays a channel (a filter, a clock, a closed loop); correct it with "
        "tv.preprocess.align_channels(recording, delay), as tvsysid identify does unless it "
        "predicts worse",
    ),
    "clock-skew": Fault(
        "The channels' clocks run apart",
        "delay of the torque in the second half of the experiment, minus that in the first",
        8,
        "ms",
        "a delay that grows: viscosity is wrong by another amount at each time of the experiment, "
        "and the rest is "
        "distorted",
        "record both channels by one clock, or stretch one of them before cutting",
    ),
    "drift": Fault(
        "The behaviour drifts over the experiment",
        "stiffness of the second half minus that of the first, over the first",
        10,
        "%",
        "the result is a mean of different behaviours, and describes none of them",
        "identify the parts of the experiment separately; let people rest or warm up before",
    ),
    "angle-offset": Fault(
        "The angle's offset drifts",
        "change of the realizations' mean from start to end, over the standard deviation about it",
        100,
        "%",
        "the drift counts as a movement, which the torque does not answer: stiffness comes out "
        "too low",
        "subtract a line, or components slower than a realization, from the recording before "
        "cutting; check the sensor",
    ),
    "torque-offset": Fault(
        "The torque's offset drifts",
        "change of the realizations' mean from start to end, over the standard deviation about it",
        100,
        "%",
        "the drift counts as torque that the angle does not explain: much more noise for the fits",
        "subtract a line, or components slower than a realization, from the recording before "
        "cutting; check the sensor",
    ),
    "unlike-realizations": Fault(
        "Some realizations are outliers",
        "realizations whose stiffness or noise lies far outside the scatter of the others",
        0,
        "realizations",
        "they count as much as the others and pull the result towards theirs",
        "look at them and exclude them (ensemble.select; tv.preprocess.prepare does it for a task "
        "with a target)",
    ),
    "scattered-realizations": Fault(
        "Realizations are of different behaviours",
        "standard deviation over realizations of the stiffness, beyond noise and drift, over the "
        "stiffness' RMS",
        10,
        "%",
        "the result is a mean of different behaviours, and describes none of them; bands do not "
        "show it",
        "sort the realizations by what may differ (task, muscle activity, instruction), and "
        "identify each kind "
        "separately; if it was recorded, let the joint follow it (tvsysid identify … --scheduling "
        "CHANNEL)",
    ),
    "misaligned-realizations": Fault(
        "Some realizations come early or late",
        "share of the realizations that fit clearly better when they are shifted",
        2,
        "%",
        "changes of stiffness are smeared over time, and peaks come out too low",
        "align them before the mean is subtracted (tv.preprocess.align), or exclude them",
    ),
    "wrong-period": Fault(
        "The behaviour does not repeat with this period, or the sampling rate is wrong",
        "variation of the stiffness with another period, as a share of the mean",
        10,
        "%",
        "each realization holds another part of the behaviour, so that the time variation "
        "averages out",
        "cut with the period that is named here, if the behaviour has one, or sort it by what it "
        "depends on; check the "
        "sampling rate: stated as a half of the true one, it makes the period twice as long",
    ),
    "clipped-angle": Fault(
        "The angle is clipped",
        "times at which the highest or lowest values of several realizations are the same",
        2,
        "%",
        "where the sensor is at its limit the torque goes on without the angle: stiffness comes "
        "out too high",
        "widen the sensor's range; exclude the realizations concerned",
    ),
    "clipped-torque": Fault(
        "The torque is clipped",
        "times at which the highest or lowest values of several realizations are the same",
        2,
        "%",
        "where the sensor is at its limit the torque does not answer: stiffness comes out too low "
        "where it is high",
        "widen the sensor's range; exclude the realizations concerned",
    ),
    "coarse-angle": Fault(
        "The angle is recorded in coarse steps",
        "smallest step between values of the angle, over its standard deviation",
        10,
        "%",
        "the steps are noise in the angle, most of it in the acceleration: inertia and viscosity "
        "come out too low, the "
        "stiffness a little",
        "record the angle with a finer converter, or a gain that uses its range; trust the "
        "stiffness only",
    ),
    "lost-angle": Fault(
        "The angle is lost for a while",
        "time during which the torque moves and the angle does not",
        MAX_STANDSTILL_S["angle"],
        "s",
        "the torque seems to move by itself there, which adds noise and mostly lowers the "
        "stiffness",
        "exclude the realizations concerned",
    ),
    "lost-torque": Fault(
        "The torque is lost for a while",
        "time during which the angle moves and the torque does not",
        MAX_STANDSTILL_S["torque"],
        "s",
        "where the torque is held or zero the joint seems to have no stiffness",
        "exclude the realizations concerned",
    ),
    "gaps": Fault(
        "Gaps in the recording",
        "gaps of 30 ms and more in both signals",
        0,
        "gaps",
        "what was held, zero or interpolated is taken for the joint's answer: stiffness is wrong, "
        "and bands too narrow",
        "tvsysid identify --period leaves out realizations with gaps; in Python, "
        "tv.preprocess.segment(decimated, "
        "period, gaps=tv.preprocess.find_gaps(recording))",
    ),
    "mains": Fault(
        "Mains hum in the angle",
        "RMS of a line at 50 or 60 Hz, over that of the angle",
        1,
        "%",
        "the hum has a large acceleration that no torque answers: inertia comes out too low, and "
        "stiffness wrong",
        "tvsysid identify subtracts it; in Python, tv.preprocess.remove_mains(recording, 50) "
        "before decimation",
    ),
    "angle-spikes": Fault(
        "Spikes in the angle",
        "highest sample that the angle's past does not predict, over the 99th percentile of all",
        2.5,
        "times",
        "a spike of one sample has a large acceleration that no torque answers: inertia comes out "
        "too low",
        "interpolate the samples or exclude the realizations; check the cables",
    ),
    "torque-spikes": Fault(
        "Spikes in the torque",
        "highest sample that neither the joint's model nor the past predicts, over the 90th "
        "percentile of all",
        8,
        "times",
        "single samples of large error weigh much in a least-squares fit",
        "interpolate the samples or exclude the realizations; check the cables",
    ),
    "feedback": Fault(
        "Closed loop: torque noise moves the angle",
        "share of the torque that later movement predicts, beyond earlier movement",
        3,
        "%",
        "the methods here take the angle as imposed; if noise in the torque moves it, stiffness, "
        "viscosity and "
        "inertia come out too low",
        "check that both channels pass the same filters; use a stiffer actuator, or identify with "
        "the actuator's "
        "command as the reference (tvsysid identify … --channel command=… --method "
        "kbr:reference=command,weighting=residual)",
    ),
    "loop-bias": Fault(
        "Closed loop: the stiffness is another with the reference",
        "mean stiffness of a fit in open loop over that with the reference as the instrument, "
        "less 1",
        5,
        "%",
        "the methods that take the angle as imposed are biased by as much; no band shows it, and "
        "no longer record "
        "mends it",
        "identify with the reference, as the finding says (kbr:reference=NAME,weighting=residual)",
    ),
    "reflex": Fault(
        "A reflex answers stretch",
        "share of the residual torque that velocity of one direction 40 to 330 ms earlier "
        "predicts at least (with 95 % "
        "certainty), beyond what both directions do alike",
        0.1,
        "%",
        "methods with one pathway take the reflex's torque for the joint's own: stiffness and "
        "inertia come out too "
        "high, viscosity too low, with short lags and with long ones; no band shows it",
        "separate the pathways: tv.JointCascade() (tvsysid identify … --method cascade)",
    ),
    "slow-answer": Fault(
        "More than stiffness, viscosity and inertia",
        "share of the residual torque that movement 40 to 300 ms earlier predicts, where no "
        "reflex is found",
        10,
        "%",
        "a model of second order (birf, kbr) misses this part; impulse responses hold it as far "
        "as their lags reach",
        "use lags as long as the answer (eirf:max_lag=0.4; sds:max_lag=0.4,window=0.4), also with "
        "--tune; look for a "
        "wrong sampling rate, a soft coupling, or a filter in one channel",
    ),
}
