"""Adaptive smoothing with switches: the evidence decides how fast stiffness may change.

The method in ``adaptive`` takes four steps:

1. ``regression`` estimates stiffness at each time by itself, by weighted least
   squares over realizations, with the covariance of its error. All further steps use this curve,
   its error and the number of realizations.
2. ``prior`` lists the smooth parts that stiffness may have: stationary kernels of some amplitude
   and length. ``smooth_priors`` is the place for another one. ``search`` finds sets of switches for
   them. ``evidence`` then adds sums of few harmonics to the smooth parts.
3. A model is a smooth part with a set of switches. ``evidence`` has the probability of the curve
   under each model, with all coefficients integrated out. A smooth part that may change fast fits
   many curves, so each of them has a low probability. One that changes too slowly leaves a
   residual larger than the noise.
4. ``averaging`` averages the models, weighted by their evidence; ``average`` has all steps from
   the curve on. ``model`` has the bands of this mixture, and lists its switches.

Viscosity is estimated in the same way, in turn with stiffness. In this package, an estimate
*beside* others is adjusted for them, as in multiple regression.
"""
