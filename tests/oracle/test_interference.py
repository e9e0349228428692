"""Jammers, spectra, loops and lock against worked link budgets, published figures, quadrature and a field test."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from navsim.geodesy.earth import SPEED_OF_LIGHT, ecef_from_llh
from navsim.gnss.constellations.systems import GLONASS, GPS
from navsim.gnss.dll import CodeLoop, chip_length
from navsim.gnss.interference import horizon, propagation, spectral_separation, tracking_threshold
from navsim.gnss.interference.spectral_separation import Band, Flat, Modulated, Spectrum, SweptTone, Tone, bpsk
from navsim.gnss.sky import azimuth_elevation, enu_matrix
from tests.conftest import DATA, Within

MEGA = 1e6
RATE = GPS.chip_rate
SPECTRA = {
    "bpsk1": bpsk(RATE),
    "bpsk10": bpsk(10.0 * RATE),
    "bpsk0p511": bpsk(GLONASS.chip_rate),
    "boc11": Spectrum(((2.0, 2.0 * RATE), (-1.0, RATE))),
}
PAIRS = sorted((one, other) for one in SPECTRA for other in SPECTRA if one <= other)


@pytest.fixture(scope="module")
def cases() -> dict[str, Any]:
    return json.loads((DATA / "integrity.json").read_text())


def decibels(ratio: np.ndarray | float) -> np.ndarray:
    return 10.0 * np.log10(ratio)


def quality(waveform: spectral_separation.Waveform) -> float:
    """Kaplan's Q of a waveform for a C/A code at its carrier."""
    return 1.0 / (RATE * float(waveform.kappa(bpsk(RATE), np.array(GPS.carrier), None)))


@pytest.mark.validates("Jammer power at the receiver, J/S and effective C/N0", "Kaplan & Hegarty, independent script",
                       level="1e-9 dB")  # fmt: skip
def test_link_budgets(cases: dict[str, Any], within: Within) -> None:
    rows = cases["js_to_cn0"]["cases"]
    assert len(rows) == 8
    for row in rows:
        loss = propagation.path_loss(np.array([[row["distance_m"]]]), row["frequency_hz"])
        gain = np.array([[row["receiver_gain_to_satellite_db"]]])
        signal = np.array([row["signal_dbw"]])
        eirp = np.array([[row["jammer_dbw"] + row["jammer_gain_dbi"]]])
        to_jammer = np.array([[row["receiver_gain_to_jammer_db"]]])
        js = propagation.jam_to_signal(eirp, loss, to_jammer, signal, gain)
        cn0 = signal + gain - propagation.noise_density(row["temperature_k"])
        left = propagation.jammed(cn0, js, np.array([[1.0 / (row["q"] * row["chip_rate_hz"])]]))
        ours = [loss.item(), js.item(), cn0.item(), left.item()]
        expected = [row[name] for name in ("path_loss_db", "js_db", "cn0_db", "cn0_effective_db")]
        np.testing.assert_allclose(ours, expected, rtol=0, atol=within["level"], err_msg=row["name"])


@pytest.mark.validates("Spectral separation and Q of jammers", "Betz 2001; independent script",
                       computed_values="1e-6 dB", printed_values="0.1 dB")  # fmt: skip
def test_spectral_separation(cases: dict[str, Any], within: Within) -> None:
    entry = cases["spectral_separation"]
    wanted, published = entry["kappa_db_per_hz"], entry["published"]
    for name, expected in wanted.items():
        one, other = name.split("_")
        ours = decibels(spectral_separation.separation(SPECTRA[one], SPECTRA[other], np.array(0.0)))
        assert ours == pytest.approx(expected, abs=within["computed_values"]), name
        assert ours == pytest.approx(published.get(name, expected), abs=within["printed_values"]), name
    waveforms = {
        "tone_at_carrier": Tone(GPS.carrier),
        "matched_bpsk": Modulated(bpsk(RATE), GPS.carrier),
        "white_null_to_null": Flat(GPS.carrier, 2.0 * RATE),
    }
    ours = decibels([quality(waveforms[name]) for name in entry["q"]])
    np.testing.assert_allclose(ours, decibels([*entry["q"].values()]), rtol=0, atol=within["computed_values"])
    np.testing.assert_allclose(ours, decibels(published["q"]), rtol=0, atol=within["printed_values"])


@pytest.mark.validates("Tracking thresholds of phase and code loops", "Kaplan & Hegarty 8.9, independent script",
                       level="1e-6 dB")  # fmt: skip
def test_thresholds_of_loops(cases: dict[str, Any], within: Within) -> None:
    entry = cases["tracking_thresholds"]
    for row in entry["dll_one_sixth_of_spacing"]:
        loop = CodeLoop(row["spacing"], row["bandwidth_hz"], row["integration_s"])
        sigma = loop.sigma(np.array(row["cn0_db"]), 1.0)
        assert sigma == pytest.approx(loop.spacing / 6.0, rel=0.12 * within["level"])
    for row in entry["tolerable_js_db"]:
        js, kappa = np.array([[[row["js_db"]]]]), np.array([[1.0 / (row["q"] * row["chip_rate_hz"])]])
        left = propagation.jammed(np.array([[row["cn0_db"]]]), js, kappa)
        assert left.item() == pytest.approx(row["threshold_db"], abs=within["level"])


@pytest.mark.validates("Effect of pulsed pseudolites on receivers", "RTCM SC-104, Gold codes of 10 stages",
                       "dB, chips, or without unit", every_number="1e-9")  # fmt: skip
def test_pulsed_pseudolite(cases: dict[str, Any], within: Within) -> None:
    entry = cases["pulsed_pseudolite"]
    duty = propagation.RTCM_DUTY
    assert duty == pytest.approx(entry["duty"], abs=within["every_number"])
    assert duty * 1023 == pytest.approx(entry["rtcm_chips_per_ms"], abs=within["every_number"])
    ours = [
        -propagation.blanked_loss(np.array([duty])),
        -propagation.gated_loss(duty),
        -propagation.ungated_loss(duty),
        propagation.cross_correlation(10),
    ]
    names = (
        "satellite_loss_blanked",
        "pseudolite_loss_gated",
        "pseudolite_loss_ungated",
        "gold_code_cross_correlation",
    )
    np.testing.assert_allclose(ours, [entry[f"{name}_db"] for name in names], rtol=0, atol=within["every_number"])


@pytest.mark.validates("Diffraction loss behind a knife edge", "ITU-R P.526", diffraction_parameter="1e-9",
                       loss="1e-9 dB")  # fmt: skip
def test_knife_edge(cases: dict[str, Any], within: Within) -> None:
    rows = cases["knife_edge"]["cases"]
    ours = propagation.edge_loss(np.array([row["nu"] for row in rows]))
    np.testing.assert_allclose(ours, [row["loss_db"] for row in rows], rtol=0, atol=within["loss"])
    row = rows[-1]
    before, behind = np.array([row["d1_m"], row["d2_m"]])
    nu = propagation.edge_parameter(row["height_m"], before, behind, SPEED_OF_LIGHT / row["frequency_hz"])
    assert nu == pytest.approx(row["nu"], abs=within["diffraction_parameter"])


@pytest.mark.validates("Noise of range rates", "Kaplan & Hegarty 8.9, independent script", "(relative)", sigma="1e-9")
def test_range_rate_noise(cases: dict[str, Any], within: Within) -> None:
    for row in cases["range_rate_noise"]["cases"]:
        loop = tracking_threshold.FrequencyLoop(row["bandwidth_hz"], row["integration_s"], row["f"])
        ours = loop.sigma(np.array(row["cn0_db"]), SPEED_OF_LIGHT / GPS.carrier)
        assert ours == pytest.approx(row["sigma_m_s"], rel=within["sigma"])


@pytest.mark.validates("Code noise of a jammed landing, step by step from the transmitter's power",
                       "independent script", level="1e-6 dB", code_noise="1e-6 m")  # fmt: skip
def test_jam_chain(cases: dict[str, Any], within: Within) -> None:
    entry = cases["jam_chain"]
    row, expected = entry["inputs"], entry["expected"]
    assert row["noise"] == "white over +-1.023 MHz"
    js = propagation.jam_to_signal(
        np.array([[row["jammer_dbw"]]]),
        propagation.path_loss(np.array([[row["path_m"]]]), row["frequency_hz"]),
        np.array([[row["receiver_gain_to_jammer_db"]]]),
        np.array([row["signal_dbw"]]),
        np.zeros((1, 1)),
    )
    kappa = Flat(row["frequency_hz"], 2.046 * MEGA).kappa(bpsk(RATE), np.array([row["frequency_hz"]]), None)
    left = propagation.jammed(np.array([[row["cn0_db"]]]), js, kappa[None])
    loop = CodeLoop(row["spacing"], row["loop_bandwidth_hz"], row["integration_s"])
    assert js.item() == pytest.approx(expected["js_db"], abs=within["level"])
    assert left.item() == pytest.approx(expected["cn0_effective_db"], abs=within["level"])
    assert loop.sigma(left, chip_length(GPS)).item() == pytest.approx(
        expected["code_sigma_m"], abs=within["code_noise"]
    )


@pytest.mark.validates("C/N0 at which lock is lost and found", "JammerTest 2024, scenario 1.6.4 (plausibility)",
                       "(between two samples, 30 s)")  # fmt: skip
def test_field_jamming(cases: dict[str, Any]) -> None:
    """Between samples the median C/N0 is taken as a straight line. Most satellites go between the one with 28 dB-Hz and
    the next; most are back a sample after that of 30 dB-Hz."""
    entry = cases["field_jamming_jammertest_2024"]
    at, heard = np.array(entry["time_of_day_s"], float), np.array(entry["satellites"])
    time = np.arange(at[0], at[-1], 0.1)
    cn0 = np.interp(time, at, entry["median_cn0_db"])
    held = tracking_threshold.LockRule().held(time, cn0[:, None])[:, 0]
    (lost,), (back,) = time[1:][held[:-1] & ~held[1:]], time[1:][held[1:] & ~held[:-1]]
    fewest = int(heard.argmin())
    assert (heard[fewest - 1 : fewest + 3]).tolist() == [8, 3, 6, 8]
    assert at[fewest - 1] < lost < at[fewest]
    assert at[fewest + 1] < back < at[fewest + 2]


def correlation(spectrum: Spectrum, lag: float) -> float:
    """Of a code with itself, by the book: a triangle; of BOC(1,1) the zigzag through 1, -1/2 and 0."""
    if len(spectrum.parts) == 1:
        return max(1.0 - abs(lag) * spectrum.parts[0][1], 0.0)
    return float(np.interp(abs(lag) * spectrum.parts[1][1], [0.0, 0.5, 1.0], [1.0, -0.5, 0.0]))


@pytest.mark.parametrize("offset", [0.0, 1e3, 0.08 * MEGA, 0.7 * MEGA, 3.3 * MEGA])
@pytest.mark.validates("Spectral separation of different carriers", "SciPy quadrature over the lag (Parseval)",
                       "of its value at equal carriers", separation_coefficient="1e-9")  # fmt: skip
def test_separation_by_lag(offset: float, within: Within) -> None:
    for one, other in PAIRS:
        a, b = SPECTRA[one], SPECTRA[other]
        end = min(a.memory, b.memory)
        corners = [x for x in (0.5 / RATE, 0.05 / RATE) if x < end]
        wanted = 2.0 * quad(
            lambda lag, a=a, b=b: correlation(a, lag) * correlation(b, lag) * np.cos(2.0 * np.pi * offset * lag),
            0.0, end, points=corners, epsabs=1e-18, epsrel=1e-12, limit=200,
        )[0]  # fmt: skip
        scale = float(spectral_separation.separation(a, b, np.array(0.0)))
        for ours in (
            spectral_separation.separation(a, b, np.array(offset)),
            spectral_separation.separation(b, a, np.array(-offset)),
        ):
            assert float(ours) == pytest.approx(wanted, abs=within["separation_coefficient"] * scale), (one, other)


@pytest.mark.validates("Spectral separation in the band of a front end", "SciPy quadrature over the frequency",
                       "(relative)", separation_coefficient="1e-9")  # fmt: skip
def test_separation_in_a_band(within: Within) -> None:
    band = Band(GPS.carrier - 4.0 * MEGA, GPS.carrier + 7.0 * MEGA)
    carriers, centre, width = GPS.carrier + np.array([-1.3, 0.0, 0.4]) * MEGA, GPS.carrier + 0.2 * MEGA, 9.0 * MEGA

    def shared(signal: Spectrum, sent: Callable[[float], float], low: float, high: float) -> list[float]:
        edges = np.linspace(low, high, 12)
        return [
            sum(
                quad(lambda f, c=carrier: sent(f) * signal.density(f - c), *ends, epsrel=1e-12)[0]
                for ends in pairwise(edges)
            )
            for carrier in carriers
        ]

    for name, signal in SPECTRA.items():
        # the noise ends within the band above, and beyond it below
        wanted = shared(signal, lambda f: 1.0 / width, band.low, centre + 0.5 * width)
        ours = Flat(centre, width).kappa(signal, carriers, band)
        np.testing.assert_allclose(ours, wanted, rtol=within["separation_coefficient"], err_msg=name)
        for other, jammer in SPECTRA.items():
            wanted = shared(signal, lambda f, jammer=jammer: float(jammer.density(f - centre)), band.low, band.high)
            ours = Modulated(jammer, centre).kappa(signal, carriers, band)
            np.testing.assert_allclose(ours, wanted, rtol=within["separation_coefficient"], err_msg=f"{name} {other}")


@pytest.mark.parametrize("band", [None, Band(GPS.carrier - 1.0 * MEGA, GPS.carrier + 0.3 * MEGA)])
def test_a_slow_sweep_is_the_mean_of_its_tones_in_the_memory(band: Band | None) -> None:
    """4 MHz in 0.8 s: within a part of a period, over its end, over more than one."""
    signal, carriers = bpsk(RATE), GPS.carrier + np.array([0.0, 0.7 * MEGA])
    low, width, period = GPS.carrier - 2.5 * MEGA, 4.0 * MEGA, 0.8
    time = np.array([0.0, 0.39, 0.5, 0.83, 7.77])
    for memory in (1e-4, 0.02, 0.5, 2.1):
        ours = SweptTone(low + 0.5 * width, width, period, memory).at(time).kappa(signal, carriers, band)
        steps = (np.arange(20000) + 0.5) / 20000
        for t, row in zip(time, ours, strict=True):
            tones = low + width * (((t - memory * steps) / period) % 1.0)
            passed = np.ones(tones.shape, bool) if band is None else (tones >= band.low) & (tones <= band.high)
            wanted = [np.mean(passed * signal.density(tones - carrier)) for carrier in carriers]
            np.testing.assert_allclose(row, wanted, rtol=2e-4, atol=1e-4 / RATE)
    # whole periods are the mean that a fast one has
    whole = SweptTone(low + 0.5 * width, width, period, 2.0 * period).at(time).kappa(signal, carriers, band)
    flat = Flat(low + 0.5 * width, width).kappa(signal, carriers, band)
    np.testing.assert_allclose(whole, np.broadcast_to(flat, whole.shape), rtol=1e-9)


def test_spectra_by_the_book() -> None:
    """sinc^2 of BPSK; of BOC(1,1) the tangent's form (Betz); the area is 1 and half of it on either side."""
    f = np.array([0.05, 0.31, 0.77, 1.4, 2.6, 7.3]) * RATE
    x = np.pi * f / RATE
    np.testing.assert_allclose(bpsk(RATE).density(f), (np.sin(x) / x) ** 2 / RATE, rtol=1e-12)
    wanted = RATE * (np.tan(x / 2.0) * np.sin(x) / (np.pi * f)) ** 2
    np.testing.assert_allclose(SPECTRA["boc11"].density(f), wanted, rtol=1e-9)
    for name, spectrum in SPECTRA.items():
        ends = spectrum.below(np.array([-1e13, 0.0, 1e13]))
        np.testing.assert_allclose(ends, [0.0, 0.5, 1.0], atol=1e-6, err_msg=name)
        assert sum(weight for weight, _ in spectrum.parts) == 1.0


def test_closed_forms_of_separation() -> None:
    """Matched: 2 / (3 R); of two rates (1 - r / (3 R)) / R; a tone sinc^2(f / R) / R."""
    for rate in (GLONASS.chip_rate, RATE, 10.0 * RATE):
        matched = Modulated(bpsk(rate), 0.0).kappa(bpsk(rate), np.zeros(1), None)
        assert matched.item() == pytest.approx(2.0 / (3.0 * rate), rel=1e-14)
    two = spectral_separation.separation(bpsk(RATE), bpsk(GLONASS.chip_rate), np.array(0.0))
    assert float(two) == pytest.approx((1.0 - GLONASS.chip_rate / (3.0 * RATE)) / RATE, rel=1e-14)
    tone = Tone(GPS.carrier + 0.4 * RATE).kappa(bpsk(RATE), np.array([GPS.carrier]), None)
    assert tone.item() == pytest.approx(np.sinc(0.4) ** 2 / RATE, rel=1e-6)


def test_a_sweep_is_the_mean_of_its_tones() -> None:
    carriers, width = np.array([GLONASS.frequency(k) for k in range(-7, 7)]), 3.0 * MEGA
    tones = GLONASS.carrier + width * ((np.arange(20000) + 0.5) / 20000 - 0.5)
    for signal in SPECTRA.values():
        mean = np.mean([Tone(f).kappa(signal, carriers, None) for f in tones], axis=0)
        np.testing.assert_allclose(Flat(GLONASS.carrier, width).kappa(signal, carriers, None), mean, rtol=1e-4)


def test_a_narrow_jammer_takes_some_channels() -> None:
    """One of 200 kHz on channel 2 raises that one's noise, and the next ones' by the side lobes alone."""
    channels = np.arange(-7, 7)
    carriers = np.array([GLONASS.frequency(int(k)) for k in channels])
    signal = bpsk(GLONASS.chip_rate)
    for jammer in (Tone(GLONASS.frequency(2)), Flat(GLONASS.frequency(2), 0.2 * MEGA)):
        kappa = jammer.kappa(signal, carriers, None)
        assert kappa.argmax() == np.flatnonzero(channels == 2)[0]
        left = propagation.jammed(np.full((1, 14), 45.0), np.full((1, 1, 14), 40.0), kappa[None])[0]
        rule = tracking_threshold.LockRule()
        assert (left < rule.lose).tolist() == (channels == 2).tolist()
        assert (left[np.abs(channels - 2) > 1] > rule.regain).all()


def test_a_front_end_stops_what_is_outside() -> None:
    band, carrier, signal = Band(-2.0 * MEGA, 2.0 * MEGA), np.zeros(1), bpsk(RATE)
    assert Tone(2.1 * MEGA).kappa(signal, carrier, band) == 0.0
    assert Flat(5.0 * MEGA, 2.0 * MEGA).kappa(signal, carrier, band) == 0.0
    assert Flat(-5.0 * MEGA, 2.0 * MEGA).kappa(signal, carrier, band) == 0.0
    assert Tone(1.9 * MEGA).kappa(signal, carrier, band) == Tone(1.9 * MEGA).kappa(signal, carrier, None)
    inside = Flat(0.5 * MEGA, 2.0 * MEGA)
    assert inside.kappa(signal, carrier, band) == inside.kappa(signal, carrier, None)
    for offset in (0.0, 1.5 * MEGA, 30.0 * MEGA):
        jammer = Modulated(bpsk(RATE), offset)
        parts = [jammer.kappa(signal, carrier, Band(a, b)) for a, b in ((-2e8, -2e6), (-2e6, 2e6), (2e6, 2e8))]
        assert all(part > 0.0 for part in parts)
        assert sum(parts).item() == pytest.approx(jammer.kappa(signal, carrier, None).item(), rel=1e-5)


levels_db = st.floats(-60.0, 120.0)


@given(st.floats(20.0, 60.0), levels_db, levels_db, st.floats(0.0, 30.0), st.floats(1e3, 1e8))
def test_more_power_never_helps(cn0: float, first: float, second: float, more: float, rate: float) -> None:
    def left(*js: float) -> float:
        kappa = np.full((len(js), 1), 1.0 / rate)
        return float(propagation.jammed(np.array([[cn0]]), np.array(js).reshape(-1, 1, 1), kappa).item())

    assert left() == pytest.approx(cn0, abs=1e-9)
    assert left(first, -np.inf) == left(first)
    both = left(first, second)
    assert both <= min(left(first), left(second)) + 1e-9
    assert left(first + more, second) <= both + 1e-9
    assert left(first, first) == pytest.approx(left(first + 10.0 * np.log10(2.0)), abs=1e-9)
    if left(first) < cn0 - 20.0:  # where the jammer is all the noise there is, 1 dB costs 1 dB
        assert left(first + more) == pytest.approx(left(first) - more, abs=0.05)


def test_every_jammer_meets_every_source() -> None:
    """Two jammers, three epochs, four sources, one of which is not received."""
    rng = np.random.default_rng(3)
    eirp, to_jammer, gain = rng.normal(0, 5, (2, 3)), rng.normal(-5, 2, (2, 3)), rng.normal(0, 2, (3, 4))
    distance = rng.uniform(1e3, 3e4, (2, 3))
    signal, kappa = np.array([-158.5, -158.5, -161.0, -161.0]), rng.uniform(1e-8, 1e-6, (2, 4))
    hidden = np.array([[0.0, 0.0, 0.0], [0.0, np.inf, 12.0]])
    loss = propagation.path_loss(distance, np.array([[GPS.carrier], [GLONASS.carrier]])) + hidden
    js = propagation.jam_to_signal(eirp, loss, to_jammer, signal, gain)
    cn0 = signal + gain - propagation.noise_density(290.0)
    cn0[:, 3] = np.nan
    left = propagation.jammed(cn0, js, kappa)
    assert np.isneginf(js[1, 1]).all()
    assert np.isnan(left[:, 3]).all()
    for e in range(3):
        for s in range(3):
            noise = 10.0 ** (-cn0[e, s] / 10.0)
            for j in range(2):
                power = eirp[j, e] - loss[j, e] + to_jammer[j, e] - signal[s] - gain[e, s]
                noise += 10.0 ** (power / 10.0) * kappa[j, s]
            assert left[e, s] == pytest.approx(-10.0 * np.log10(noise), abs=1e-9)


def test_shadow_of_edges_and_of_the_horizon() -> None:
    """An edge at the straight path takes 6 dB, a clear one nothing; a higher one never takes less."""
    nu = np.linspace(-50.0, 50.0, 2001)
    loss = propagation.edge_loss(nu)
    assert (np.diff(loss) >= 0.0).all()
    assert (loss[nu < -0.78] == 0.0).all()
    assert float(propagation.edge_loss(np.array(0.0))) == pytest.approx(20.0 * np.log10(2.0), abs=0.02)
    far = propagation.radio_horizon(np.array([100.0, 0.0, -3.0]), 25.0)
    np.testing.assert_allclose(far, [61.8e3, 20.6e3, 20.6e3])
    beyond = propagation.horizon_loss(np.array([61.0e3, 62.0e3]), 100.0, 25.0)
    assert beyond.tolist() == [0.0, np.inf]


EYE = np.array([np.radians(56.0), np.radians(37.0), 120.0])


def about_the_eye(*enu: tuple[float, float, float]) -> np.ndarray:
    """Places in the tangent plane of `EYE` (n, 3), ECEF."""
    return ecef_from_llh(EYE) + np.array(enu) @ enu_matrix(EYE)


def bent(before: float, behind: float) -> float:
    """How far rays over an Earth of 4/3 of its radius rise over a straight line: the difference of both curves."""
    return before * behind / 2.0 * (1.0 / 6371.0e3 - 3.0 / (4.0 * 6371.0e3))


@pytest.mark.validates("Diffraction loss behind a ridge", "ITU-R P.526: knife edge, independent script", "dB",
                       loss="1e-6")  # fmt: skip
def test_a_ridge_is_the_knife_edge(cases: dict[str, Any], within: Within) -> None:
    """The oracle's 10 m over a path of 1 and 3 km, to an aircraft beyond it; a slanting path misses the edge by less;
    past the ends, before and behind it nothing is lost, and of two the worse counts."""
    row = cases["knife_edge"]["cases"][-1]
    d1, d2, wavelength = row["d1_m"], row["d2_m"], SPEED_OF_LIGHT / row["frequency_hz"]
    top = row["height_m"] + bent(d1, d2)
    (place,) = about_the_eye((0.0, -d1, 0.0))
    antenna = about_the_eye((0.0, d2, 0.0), (0.0, -2.0 * d1, 0.0), (0.0, -0.5 * d1, 0.0), (4.0 * d2, d2, 0.0))
    ridge = about_the_eye((-500.0, 0.0, top), (500.0, 0.0, top))[None]
    loss = horizon.ridge_loss(ridge, place, antenna, wavelength)
    assert loss[0] == pytest.approx(row["loss_db"], abs=within["loss"])
    assert loss[1:].tolist() == [0.0, 0.0, 0.0]
    low = about_the_eye((-500.0, 1.0, -200.0), (500.0, 1.0, -200.0))[None]
    assert horizon.ridge_loss(low, place, antenna[:1], wavelength).tolist() == [0.0]
    for tops in (np.concatenate([low, ridge]), np.concatenate([ridge, low]), ridge[:, ::-1]):
        np.testing.assert_array_equal(horizon.ridge_loss(tops, place, antenna, wavelength), loss)
    assert horizon.ridge_loss(np.empty((0, 2, 3)), place, antenna, wavelength).tolist() == [0.0] * 4
    # to an aircraft 30 degrees up: the edge is its height times the cosine away from the ray
    rise = np.tan(np.radians(30.0))
    up = about_the_eye((0.0, d2, d2 * rise))
    (place,) = about_the_eye((0.0, -d1, -d1 * rise))
    far = d1 / np.cos(np.radians(30.0)), d2 / np.cos(np.radians(30.0))
    over = (top - bent(*far)) * np.cos(np.radians(30.0))
    nu = propagation.edge_parameter(np.array(over), np.array(far[0]), np.array(far[1]), wavelength)
    found = horizon.ridge_loss(ridge, place, up, wavelength)
    assert found[0] == pytest.approx(float(propagation.edge_loss(nu)), abs=within["loss"])


def test_a_skyline_is_where_it_is_seen() -> None:
    """Its corners seen from the eye; through north; all around; between them it is lower by the cosine of half a
    degree at most."""
    for azimuths, parts in (((0.3, 0.8), 29), ((np.radians(350.0), np.radians(10.0)), 20), ((0.0, 2.0 * np.pi), 360)):
        tops = horizon.skyline(EYE, azimuths, 0.1, 2000.0)
        assert tops.shape == (parts, 2, 3)
        seen = (tops - ecef_from_llh(EYE)) @ enu_matrix(EYE).T
        np.testing.assert_allclose(np.linalg.norm(seen[..., :2], axis=-1), 2000.0, rtol=1e-9)
        azimuth, elevation = azimuth_elevation(seen / np.linalg.norm(seen, axis=-1, keepdims=True))
        np.testing.assert_allclose(elevation, 0.1, atol=1e-9)
        np.testing.assert_allclose(np.exp(1j * azimuth[[0, -1], [0, 1]]), np.exp(1j * np.array(azimuths)), atol=1e-9)
        np.testing.assert_array_equal(tops[1:, 0], tops[:-1, 1])
    (place,) = about_the_eye((0.0, 9000.0, 20.0))
    antenna = about_the_eye((0.0, 0.0, 5.0), (0.0, 5000.0, 5.0))
    loss = horizon.ridge_loss(tops, place, antenna, 0.19)
    nu = propagation.edge_parameter(np.array(2000.0 * np.tan(0.1) - 8.3), np.array(7000.0), np.array(2000.0), 0.19)
    assert loss[0] == pytest.approx(float(propagation.edge_loss(nu)), abs=0.05)
    assert loss[1] == 0.0


def test_two_pulsed_pseudolites_cost_satellites_both_duties() -> None:
    duty = propagation.RTCM_DUTY
    assert propagation.blanked_loss(np.array([duty, duty])) == pytest.approx(-decibels(1.0 - 2.0 / 11.0))
    assert propagation.blanked_loss(np.empty(0)) == 0.0
    assert propagation.gated_loss(1.0) == propagation.ungated_loss(1.0) == 0.0


def test_lock_waits() -> None:
    """Lost at the epoch half a second after the first below 28, back two seconds after the first above 31; a shorter
    visit to either side starts the wait anew."""
    time = 0.1 * np.arange(100)
    cn0 = np.full((100, 4), 40.0)
    cn0[10:, 0] = 27.9
    cn0[10:, 1], cn0[14, 1] = 27.9, 28.0
    cn0[:, 2] = 30.0
    cn0[:20, 2], cn0[40:, 2], cn0[50, 2] = 27.0, 32.0, 31.0
    cn0[:30, 3] = np.nan
    held = tracking_threshold.LockRule().held(time, cn0)
    firsts = [held[:, 0].argmin(), held[:, 1].argmin(), held[:, 2].argmax(), held[:, 3].argmax()]
    assert firsts == [15, 20, 71, 50]
    assert held.sum(axis=0).tolist() == [15, 20, 29, 50]
    assert tracking_threshold.LockRule().held(np.empty(0), np.empty((0, 4))).shape == (0, 4)


def test_lock_between_its_levels_stays_as_it_is() -> None:
    time, cn0 = np.arange(50.0), np.full((50, 1), 29.0)
    assert tracking_threshold.LockRule().held(time, cn0).all()
    cn0[5:8] = 20.0
    assert tracking_threshold.LockRule().held(time, cn0)[:, 0].sum() == 6


@given(st.lists(st.lists(st.floats(20.0, 40.0), min_size=3, max_size=3), min_size=1, max_size=30), st.floats(0.05, 3.0))
def test_lock_follows_signal(rows: list[list[float]], step: float) -> None:
    """Sources do not matter to each other; what is never below `lose` is held, what changes was beyond its level."""
    cn0, time, rule = np.array(rows), step * np.arange(len(rows)), tracking_threshold.LockRule()
    held = rule.held(time, cn0)
    for s in range(3):
        np.testing.assert_array_equal(rule.held(time, cn0[:, s : s + 1])[:, 0], held[:, s])
    assert held[:, (cn0 >= rule.lose).all(axis=0)].all()
    assert (cn0[1:][~held[1:] & held[:-1]] < rule.lose).all()
    assert (cn0[1:][held[1:] & ~held[:-1]] > rule.regain).all()
    at_once = tracking_threshold.LockRule(lose_s=0.0, regain=np.nextafter(28.0, 0.0), regain_s=0.0)
    np.testing.assert_array_equal(at_once.held(time, cn0), cn0 >= 28.0)
