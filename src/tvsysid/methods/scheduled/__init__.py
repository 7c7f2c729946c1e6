"""A joint that follows a measured variable.

The methods are in scheduled.py, the terms of the torque and the model in model.py, and the
regression with the choice of its orders in regression.py.
"""
