"""Four small methods, each of a kind that the package itself does not have.

They are no good estimators. They show that the contract holds what such methods need and what
they return."""

import attrs
import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import bilinear, lfilter

import tvsysid as tv
from tvsysid import Estimate, Input, StandardError
from tvsysid.dataset_layout import UNITS
from tvsysid.models import IMPEDANCE

WINDOW = 11
"""Samples over which a joint is taken as constant."""


def windowed(values, axis=0):
    return WINDOW * uniform_filter1d(values, WINDOW, axis=axis, mode="constant")


def products(x, y):
    """Return sums over realizations and a window, shape (time, regressor, regressor)."""
    return windowed(np.einsum("irt,jrt->tij", x, y))


class Toy(tv.Method):
    """A torque that is a sum of regressors (regressor, realization, time) times parameters."""

    names = IMPEDANCE

    def regressors(self, ensemble):
        return ensemble.derivatives()

    def instruments(self, ensemble):
        return self.regressors(ensemble)

    def fit(self, ensemble):
        """Fit a sliding window that contains all realizations."""
        regressors, instruments = self.regressors(ensemble), self.instruments(ensemble)
        known = np.isfinite([regressors, instruments]).all(axis=(0, 1))
        torque = ensemble.torque[:, ensemble.core]
        x, z, y = (np.where(known, each, 0.0) for each in (regressors, instruments, torque))
        inverse = np.linalg.pinv(products(z, x))
        values = (inverse @ products(z, y[None]))[..., 0].T
        left = np.sum(np.where(known, y - np.einsum("it,irt->rt", values, x), 0.0) ** 2, axis=0)
        noise = windowed(left) / np.maximum(windowed(known.sum(axis=0).astype(float)), 1.0)
        spread = np.einsum("tij,tjk,tik->it", inverse, products(z, z), inverse)
        values[:, ~known.any(axis=0)] = np.nan
        errors = np.sqrt(np.maximum(noise * spread, 0.0)) + 0 * values
        estimates = {
            name: Estimate(value, UNITS[name], error=StandardError(error, np.inf))
            for name, value, error in zip(self.names, values, errors, strict=True)
        }
        return self.model_of(ensemble, values, estimates)

    def model_of(self, ensemble, parameters, estimates, **further):
        def pathways(other):
            torques = parameters.reshape(len(parameters), 1, -1) * self.regressors(other)
            reflex = {"reflex": torques[3]} if "reflex_gain" in estimates else {}
            return {"intrinsic": torques.sum(axis=0) - sum(reflex.values())} | reflex

        return tv.Model.of(ensemble, estimates=estimates, pathways=pathways, **further)


class Cascade(Toy):
    """A second-order joint beside a stretch reflex.

    The reflex is the velocity, delayed, rectified and passed through a muscle.
    """

    names = (*IMPEDANCE, "reflex_gain")
    quantities = ("reflex_gain",)
    pathway_names = ("intrinsic", "reflex")

    def regressors(self, ensemble):
        rate, late = ensemble.sampling_rate, round(0.040 * ensemble.sampling_rate)
        stretch = np.maximum(np.gradient(ensemble.angle, 1 / rate, axis=1), 0.0)
        muscle = bilinear([15.6**2], [1.0, 2 * 0.62 * 15.6, 15.6**2], fs=rate)
        reflex = lfilter(*muscle, np.pad(stretch, ((0, 0), (late, 0)))[:, : stretch.shape[1]])
        # The reflex depends on the angle before the start, which is unknown
        reflex[:, : round(0.4 * rate)] = np.nan
        if ensemble.mean_subtracted:
            reflex -= reflex.mean(axis=0)
        return np.concatenate([ensemble.derivatives(), reflex[None, :, ensemble.core]])


class Scheduled(Toy):
    """A stiffness that rises in a straight line with the muscle's activity, whatever the time."""

    inputs = (Input("emg", "scheduling", "1"),)
    quantities = ("stiffness_at_emg",)

    def regressors(self, ensemble):
        angle, velocity, acceleration = ensemble.derivatives()
        emg = ensemble.signal("emg")[:, ensemble.core]
        return np.stack([angle, velocity, acceleration, angle * emg])

    def fit(self, ensemble):
        regressors, torque = self.regressors(ensemble), ensemble.torque[:, ensemble.core]
        known = np.isfinite(regressors).all(axis=0)
        x, y = regressors[:, known], torque[known]
        inverse = np.linalg.inv(x @ x.T)
        values = inverse @ (x @ y)
        covariance = inverse * np.mean((y - values @ x) ** 2)

        def stiffness(emg, *axes):
            variance = covariance[0, 0] + 2 * emg * covariance[0, 3] + emg**2 * covariance[3, 3]
            error = StandardError(np.sqrt(variance), np.inf)
            return Estimate(values[0] + values[3] * emg, "N m/rad", axes, error)

        emg = ensemble.signal("emg")[:, ensemble.core]
        levels = np.linspace(emg.min(), emg.max(), 20)
        estimates = {
            "stiffness": stiffness(emg, "realization", "time"),
            "stiffness_at_emg": stiffness(levels, "emg"),
        }
        impedance = dict(zip(IMPEDANCE[1:], values[1:], strict=False))
        return self.model_of(ensemble, values, estimates, coordinates={"emg": levels}, **impedance)


class Instrumental(Toy):
    """A joint in a closed loop, where noise moves the angle, too.

    The instrument is what the reference moves.
    """

    inputs = (Input("disturbance", "reference", "N m"),)

    def instruments(self, ensemble):
        reference, length = ensemble.signal("disturbance"), ensemble.angle.shape[1]
        padded = np.pad(reference, ((0, 0), (30, 4)))
        lagged = np.stack([padded[:, first : first + length].ravel() for first in range(35)])
        weights = np.linalg.lstsq(lagged.T, ensemble.angle.ravel(), rcond=None)[0]
        moved = (weights @ lagged).reshape(ensemble.angle.shape)
        return attrs.evolve(ensemble, angle=moved).derivatives()


class Recursive(Toy):
    """A joint that changes from one realization to the next: those before count less and less."""

    contiguous = True

    def skip(self, ensemble):
        return None if len(ensemble) >= 3 else f"it needs 3 realizations, got {len(ensemble)}"

    def fit(self, ensemble):
        regressors, torque = self.regressors(ensemble), ensemble.torque[:, ensemble.core]
        known = np.isfinite(regressors).all(axis=0)
        x = np.where(known, regressors, 0.0)

        def so_far(products):
            return lfilter([1.0], [1.0, -0.8], windowed(products, axis=1), axis=0)

        left = so_far(np.einsum("irt,jrt->rtij", x, x))
        values = np.einsum(
            "rtij,rtj->irt", np.linalg.pinv(left), so_far(np.einsum("irt,rt->rti", x, torque))
        )
        values[:, ~known] = np.nan
        axes = ("realization", "time")
        pairs = zip(IMPEDANCE, values, strict=True)
        estimates = {name: Estimate(each, UNITS[name], axes) for name, each in pairs}
        return self.model_of(ensemble, values.mean(axis=1), estimates)


TOYS = (Cascade, Scheduled, Instrumental, Recursive)
