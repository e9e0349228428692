"""Landings that the linear covariance analysis, and method rare on top of it, can handle."""

from __future__ import annotations

from typing import TYPE_CHECKING

from navsim.scenario.filter import SMOOTHERS
from navsim.scenario_files.base import reject

if TYPE_CHECKING:
    from navsim.scenario.landing import Landing


def check_analysable(landing: Landing) -> None:
    """Raise for scenarios that the covariance analysis cannot handle."""
    if landing.receiver.fix_states is not None and landing.method != "rare":
        text = "a state of the fixes that changes at random is not Gaussian: use method monte-carlo or rare"
        raise reject(text, "receiver", "fix_states")
    if landing.beacons is not None and landing.filter.beacons.second_order:
        text = "the covariance analysis is linear: use method monte-carlo"
        raise reject(text, "filter", "beacons", "second_order")
    if landing.box is not None and landing.box.error != "navigation" and landing.method == "covariance":
        text = "the covariance analysis is of the route; use method rare or monte-carlo, or `error: navigation`"
        raise reject(text, "box", "error")
    if landing.breaks_off and landing.method != "rare":
        text = "the covariance analysis has no alarms; use method rare or monte-carlo, or height_m"
        raise reject(text, "approach", "go_around", "on_alarm")
    if landing.integrity is not None and landing.integrity.error_model != "gaussian":
        raise reject(
            "covariance analysis and method rare assume Gaussian noise with the sigmas of the filter model; use "
            "method monte-carlo, or `error_model: gaussian`",
            "integrity",
            "error_model",
        )
    if (further := landing.imu.monte_carlo_only(landing.method == "rare")) is not None:
        text = (
            "only Monte Carlo models it; the covariance analysis, on which method rare also rests, does not: "
            "use method monte-carlo"
        )
        if landing.method == "rare" and further != landing.imu.monte_carlo_only(rare=False):
            key = further[-1]
            none = "null" if key.startswith("range_") else "0"
            text = (
                "the covariance analysis has it, the pushed runs of method rare do not yet; use method monte-carlo "
                f"or covariance, or leave it out: `{key}: {none}`"
            )
        raise reject(text, "imu", *further)
    differential = landing.pseudolites.differential
    link = None if differential is None else differential.link
    if landing.method == "rare" and link is not None and link.loss > 0.0:
        text = "the pushed runs of method rare do not know of lost corrections; use method monte-carlo, or 0"
        raise reject(text, "pseudolites", "differential", "link", "loss")
    if landing.filter.kind in SMOOTHERS:
        raise reject(
            f"{landing.filter.kind} is a smoother; the covariance analysis and method rare need a filter: use method "
            "monte-carlo, or another filter.kind",
            "filter",
            "kind",
        )
