"""How a simulated recording is identified on the command line."""

IDENTIFY = ("--angle", "angle", "--torque", "torque", "--rate", 1000, "--decimate", 100, "--period", 2)
