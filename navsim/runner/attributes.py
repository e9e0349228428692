"""The root attributes every result file has."""

from __future__ import annotations

import datetime
import hashlib
from typing import Any

import navsim
from navsim.results.schema import SCHEMA_VERSION
from navsim.scenario.load import resolved_yaml
from navsim.scenario_files.base import Section, utc_text

_UTC = "%Y-%m-%dT%H:%M:%SZ"


def root_attributes(
    kind: str, seed: int, scenario: Section, *, study: Section | None = None, **more: Any
) -> dict[str, Any]:
    """Root attributes of a result: kind, software, and the full text of scenario and study.

    The scenario has `epoch`; the title is the study's, if there is one.
    """
    text = resolved_yaml(scenario)
    of_study = resolved_yaml(study) if study is not None else ""
    epoch: datetime.datetime = scenario.epoch  # type: ignore[attr-defined]
    return {
        "kind": kind,
        "schema_version": SCHEMA_VERSION,
        "navsim_version": navsim.__version__,
        "seed": seed,
        "scenario": text,
        **({"study": of_study} if study is not None else {}),
        "scenario_sha256": hashlib.sha256((of_study + text).encode()).hexdigest(),
        "epoch": utc_text(epoch),
        "created": datetime.datetime.now(datetime.UTC).strftime(_UTC),
        "title": (study or scenario).title,  # type: ignore[attr-defined]
        **more,
    }
