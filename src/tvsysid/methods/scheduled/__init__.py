"""A joint that follows a measured variable.

The methods are in scheduled.py, the columns of their regression in terms.py, its solution and the
choice of orders in regression.py, and the model in model.py.
"""
