import numpy as np
import pytest

from tvsysid.numerics import spectra


@pytest.mark.parametrize("length", [8, 9, 30])
@pytest.mark.parametrize("realizations", [6, 100])
def test_spectra_equal_those_of_segments(random, length, realizations):
    u, y = random.normal(size=(realizations, 140)), random.normal(size=(realizations, 140)) + 1
    found = spectra.short_time_spectra(u, y, length)
    window = spectra.hann(length)
    for i in range(140 - length + 1):
        transform_u = np.fft.rfft(u[:, i : i + length] * window)
        transform_y = np.fft.rfft(y[:, i : i + length] * window)
        for values, expected in (
            (found.uu[i], transform_u * transform_u.conj()),
            (found.yu[i], transform_y * transform_u.conj()),
            (found.yy[i], transform_y * transform_y.conj()),
        ):
            np.testing.assert_allclose(values, expected.mean(axis=0) / length, atol=1e-10)


@pytest.mark.parametrize("length", [30, 31])
def test_window_peaks_at_its_centre_and_is_symmetric_about_it(length):
    window = spectra.hann(length)
    assert np.argmax(window) == length // 2
    assert window[length // 2] == 1.0
    inner = window[1:] if length % 2 == 0 else window
    np.testing.assert_allclose(inner, inner[::-1])


def test_power_shares():
    time = np.arange(400) / 100
    two = np.sin(2 * np.pi * 2 * time) + 3 * np.sin(2 * np.pi * 10 * time) + 5
    assert spectra.power_share(two[None], 100.0, 5.0) == pytest.approx(0.9, abs=0.01)
    assert spectra.power_share(np.zeros((1, 8)), 100.0, 0.0) == 0.0
