"""Tables of measurements for a filter: fixes, ranges, sensors beside the receiver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from navsim.filter import states
from navsim.filter.design import FilterDesign
from navsim.filter.estimate import in_all_lanes
from navsim.filter.measurement_kinds import FIX, RANGE, FixTable, Measurements, RangeTable
from navsim.geodesy.earth import llh_from_ecef, shifted
from navsim.gnss.dop import MAX_CLOCKS
from navsim.simulation.range_curvature import diagonal_bound

if TYPE_CHECKING:
    from navsim.simulation.flight import Flight


def table_of_fixes(design: FilterDesign, llh: np.ndarray, velocity: np.ndarray, covariance: np.ndarray) -> FixTable:
    """Fixes (m, 3), (m, 3), (m, 6, 6) as the filter takes them."""
    used = velocity if design.velocity else np.full_like(velocity, np.nan)
    assumed = covariance if design.sigma_scale == 1.0 else design.sigma_scale**2 * covariance
    return FixTable(llh, used, assumed, design.lever_arm)


def table_of_all_fixes(
    flight: Flight, llh: np.ndarray, velocity: np.ndarray, covariance: np.ndarray, epochs: slice = slice(None)
) -> FixTable:
    """Table of the fixes (e, 3), (e, 3), (e, 6, 6) of one run, or of lanes, with time-correlated errors of the filter
    model.

    epochs: their epochs.
    """
    correlated, bias, lanes = flight.design.correlated, flight.fix_bias, covariance.ndim == 4
    noise = flight.noise_along_route
    if noise is not None:
        # a fix of another receiver may come where the scenario's has none
        known = flight.shared.fix_errors.fixed[epochs, None, None]
        covariance = in_all_lanes(noise[epochs]) if lanes else np.where(known, noise[epochs], covariance)
    elif correlated is not None:
        more = flight.shared.fix_errors.of_kinds(correlated.factor - 1.0)[epochs]
        covariance = covariance + (more[..., None] if lanes else more)
    if flight.reflection_sigma is not None:
        more = flight.shared.fix_errors.of_ranges(flight.reflection_sigma)[epochs]
        covariance = covariance + (more[..., None] if lanes else more)
    if bias is not None:
        mean, route = bias[epochs], llh_from_ecef(flight.shared.signals.antenna[epochs])
        llh = shifted(llh, -mean[:, : states.VEL], route)
        velocity = velocity - mean[:, states.VEL :].reshape(-1, 3, *(1,) * (velocity.ndim - 2))
    table = table_of_fixes(flight.design, llh, velocity, covariance)
    if flight.transmitter_states is not None:
        table = table._replace(transmitters=flight.transmitter_effects[epochs])
    return table if correlated is None else table._replace(correlated=flight.correlated_roots[epochs])


def table_of_ranges(flight: Flight, ranges: np.ndarray, rates: np.ndarray) -> RangeTable:
    """Table of the pseudoranges and range rates (e, s) of one run, or of lanes, for a tightly coupled filter."""
    signals, design, heard = flight.shared.signals, flight.design, flight.shared.signals.used
    bias = np.full(MAX_CLOCKS, -1)
    bias[list(flight.scales)] = np.arange(len(flight.scales))
    source, curvature = np.nonzero(heard)[1], flight.range_curvature
    sigma = np.stack([flight.range_sigma[heard], flight.rate_sigma[heard]], axis=1)
    off = flight.range_bias[heard].reshape(-1, *(1,) * (ranges.ndim - 2))
    given = np.stack([ranges[heard] - off, rates[heard]], axis=1)
    if curvature is not None:
        sigma = np.sqrt(sigma**2 + diagonal_bound(curvature.noise))
        given = given - curvature.mean.reshape(*curvature.mean.shape, *(1,) * (given.ndim - 2))
    sigma, own = design.sigma_scale * sigma, flight.transmitter_states
    return RangeTable(
        signals.position[heard], signals.velocity[heard], signals.range[heard], sigma[:, 0].copy(), sigma[:, 1].copy(),
        source, bias[signals.time_scale[source]], given[:, 0].copy(),
        given[:, 1].copy() if design.velocity else np.full_like(given[:, 1], np.nan), design.lever_arm,
        design.sigma_scale * flight.range_error_sigma[heard],
        np.empty((source.size, 2, 0)) if own is None else own.on_ranges(np.nonzero(heard)[0], source),
    )  # fmt: skip


def measurements(flight: Flight, own: FixTable | RangeTable, aided: Sequence[np.ndarray]) -> Measurements:
    """All measurements for the filter: fixes or ranges, and those of each sensor beside the receiver (m, k).

    Of one run, or of lanes.
    """
    of_aids = zip(flight.shared.aids, aided, strict=True)
    kind, shape = (FIX, own.llh.shape[2:]) if isinstance(own, FixTable) else (RANGE, own.pseudorange.shape[1:])
    tables = {kind: own, **{aid.sensor.kind: aid.table(measured) for aid, measured in of_aids}}
    return Measurements.of(tables, *shape)
