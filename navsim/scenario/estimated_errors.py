"""Errors that the filter of a landing estimates as states, inflates its sigmas for, or leaves out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from navsim.scenario.imu import Accelerometer, Gyro, assumed_sensor
from navsim.scenario_files.base import reject

if TYPE_CHECKING:
    from navsim.scenario.landing import Landing


def check_gains(landing: Landing, name: str, key: str) -> None:
    """Check that a filter that estimates gains of the inertial sensors (its key `name`) has their sigmas, from
    `key`."""
    sensors = ("gyro", "accelerometer")
    design = [(s, part) for s in sensors if (part := getattr(landing.filter.imu, s)) is not None]
    given = {s: value for s, part in design if (value := getattr(part, key)) is not None}
    if getattr(landing.filter, name):
        if not _known_gains(landing, key):
            text = f"there are none: give imu.gyro.{key}, imu.accelerometer.{key}, or those of filter.imu"
            raise reject(text, "filter", name)
    elif given:
        raise reject(f"is for `filter.{name}: true`", "filter", "imu", next(iter(given)), key)


def _known_gains(landing: Landing, key: str) -> int:
    """Number of inertial sensors with a gain, by `key`, in the filter model."""
    truth: list[Gyro | Accelerometer] = [landing.imu.gyro, landing.imu.accelerometer]
    given: list[Gyro | Accelerometer | None] = [landing.filter.imu.gyro, landing.filter.imu.accelerometer]
    sizes = (getattr(t if g is None else assumed_sensor(t, g), key) for t, g in zip(truth, given, strict=True))
    return sum(bool(size) for size in sizes)


def gain_states(landing: Landing) -> int:
    """Largest number of gains of the inertial sensors that the filter estimates: by default only large ones."""
    scales = 0 if landing.filter.scale_factors is False else 3 * _known_gains(landing, "scale_ppm")
    return scales + (0 if landing.filter.misalignments is False else 6 * _known_gains(landing, "misalignment_mrad"))


def check_correlated(landing: Landing) -> None:
    """Check the filter's handling of time-correlated errors."""
    if landing.filter.pseudolites.refractivity_sigma_n and landing.pseudolites.air is None:
        text = "ranges have no delay by air; give pseudolites.air"
        raise reject(text, "filter", "pseudolites", "refractivity_sigma_n")
    watched = watches_filter(landing)
    drawn = landing.pseudolites.drawn
    lasts = "is not possible with {}, which lasts: its levels treat errors as independent in time; use {}mhss"
    if watched and drawn:
        raise reject(lasts.format(f"pseudolites.{drawn[0]}", ""), "integrity", "method")
    for name, section in landing.aiding_sections().items() if watched else ():
        if key := section.error_without_state(landing):
            way = f"filter.{name}.errors: states, or "
            raise reject(lasts.format(f"{name}.{key}", way), "integrity", "method")
    if not landing.signals.errors.models():
        reflected = landing.pseudolites.multipath is not None and landing.pseudolites.placed()
        if landing.filter.fix_errors == "states" and reflected:
            raise reject("reflections are no states; use inflate or none", "filter", "fix_errors")
        if landing.filter.fix_errors is not None and not reflected and not drawn:
            text = "there are none: give signals.errors, a signals.preset that has them, or errors of pseudolites"
            raise reject(text, "filter", "fix_errors")
        if landing.filter.fix_errors != "states" or not drawn:
            return
    if _excludes_fixes(landing) and about_correlated_errors(landing) == "states":
        text = "after an exclusion fixes have other errors than those that the states follow; use inflate"
        raise reject(text, "filter", "fix_errors")
    if watched and not (landing.filter.tight and about_correlated_errors(landing) == "inflate"):
        text = "levels of the filter treat errors of fixes as independent in time; use `filter.coupling: tight` with "
        also = "`filter.fix_errors: inflate`, or `integrity.method: mhss`, which judges fixes alone"
        raise reject(text + also, "integrity", "method")


def watches_filter(landing: Landing) -> bool:
    """Whether the monitor is one of the filter."""
    return landing.monitored and landing.integrity is not None and landing.integrity.method == "filter"


def about_correlated_errors(landing: Landing) -> Literal["states", "inflate", "none"]:
    """The filter's handling of time-correlated ranging errors, if there are any."""
    return landing.filter.fix_errors or ("inflate" if landing.filter.tight and watches_filter(landing) else "states")


def _excludes_fixes(landing: Landing) -> bool:
    """Whether fixes may be made without some of their sources."""
    excludes = landing.integrity is not None and landing.integrity.exclusion != "none"
    return excludes and not landing.filter.tight and not watches_filter(landing)


def about_transmitter_errors(landing: Landing) -> Literal["states", "inflate", "none"]:
    """The filter's handling of the errors of pseudolites that are drawn; with exclusion fixes have other errors
    than states would follow."""
    return landing.filter.fix_errors or ("inflate" if _excludes_fixes(landing) else about_correlated_errors(landing))


def correlated_states(landing: Landing, sources: int) -> int:
    """Number of states for time-correlated errors of fixes, or of the ranges of so many sources."""
    from navsim.gnss.correlated_errors import SUMS

    if about_correlated_errors(landing) != "states":
        return 0
    groups = len({kind.time >= landing.duration_s for kind in landing.signals.errors.models()})
    return groups * (sources if landing.filter.tight else SUMS)


def transmitter_states(landing: Landing) -> int:
    """Number of states for errors of pseudolites."""
    if not landing.pseudolites.drawn or about_transmitter_errors(landing) != "states":
        return 0
    errors = landing.pseudolites.errors(landing.filter.pseudolites)
    each = 3 * (errors.survey > 0.0) + (errors.bias > 0.0) + errors.clock_states
    count = len(landing.pseudolites.placed())
    return each * count + (errors.refractivity > 0.0 and count > 0)


def check_fix_states(landing: Landing) -> None:
    """Check that fixes with a state have errors of their own alone, and a filter that uses fixes."""
    if landing.receiver.fix_states is None:
        if landing.filter.fix_flag != "believe":
            raise reject("fixes have no flag: give `receiver.fix_states`", "filter", "fix_flag")
        return
    if landing.filter.tight:
        text = "its ambiguities are not modelled, so ranges have no state: for `filter.coupling: loose`"
        raise reject(text, "receiver", "fix_states")
    if landing.signals.errors.models() or landing.pseudolites.drawn or landing.pseudolites.multipath is not None:
        text = "fixes with a state have the errors of their state: leave out signals.errors, signals.preset, and"
        raise reject(f"{text} drawn errors and multipath of pseudolites", "receiver", "fix_states")
    watched = landing.integrity
    if watched is not None and (watched.method == "filter" or watched.exclusion != "none"):
        text = "levels and exclusions are those of fixes from ranges; use method mhss or chi2, without exclusion,"
        raise reject(f"{text} with `innovations` to watch fixes with a state", "integrity", "method")
