"""A joint that follows a measured variable.

The methods are in methods.py, their regressors and model in the other modules.
"""
