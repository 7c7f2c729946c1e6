"""Adaptive smoothing with switches: the evidence decides how fast stiffness may change.

The method in ``adaptive`` takes four steps:

1. ``regression`` estimates stiffness at each time by itself, by weighted least
   squares over realizations, with the covariance of its error. From here on there are no
   realizations, only this curve and its error.
2. ``prior`` lists the models: a constant plus a smooth part of some size and length, plus
   switches. ``search`` proposes where the switches are.
3. ``evidence`` gives each model the probability of the curve under it, with all coefficients
   integrated out. A rough smooth part fits any curve, and so makes this one improbable. A part that
   is too smooth leaves more than the noise explains.
4. ``averaging`` averages the models, weighted by their evidence. ``model`` has the bands of
   this mixture, and lists its switches.

Viscosity is estimated in the same way, beside stiffness.
"""
