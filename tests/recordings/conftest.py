import pytest


@pytest.fixture
def signals(random):
    """Angle (rad) and torque (N·m), 600 samples of each."""
    return random.normal(scale=0.1, size=600), random.normal(size=600)
