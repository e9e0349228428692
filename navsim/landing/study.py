"""Landing studies: a scenario as models, Monte Carlo and covariance analysis of it, the result."""

from navsim.landing.case import Case, prepare
from navsim.landing.controlled import stopping_rule
from navsim.landing.covariance import (
    covariance_analysis,
    covariance_findings,
    covariance_result,
    covariance_summary,
    judged_without_runs,
)
from navsim.landing.ensemble import LandingStudy, findings, fly_all, partial_key
from navsim.landing.result import result

__all__ = [
    "Case",
    "LandingStudy",
    "covariance_analysis",
    "covariance_findings",
    "covariance_result",
    "covariance_summary",
    "findings",
    "fly_all",
    "judged_without_runs",
    "partial_key",
    "prepare",
    "result",
    "stopping_rule",
]
