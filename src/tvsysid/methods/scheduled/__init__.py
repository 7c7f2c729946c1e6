"""A joint that follows a measured variable: the methods are in methods.py, their regressors and model in the others."""
