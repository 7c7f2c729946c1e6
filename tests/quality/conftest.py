import pytest
from tests.faults import cut, simulated

import tvsysid as tv


@pytest.fixture(scope="session")
def clean():
    """Ensemble of a simulated joint with nothing wrong."""
    return cut(simulated())


@pytest.fixture(scope="session")
def diagnosis(clean):
    return tv.diagnose(clean)


@pytest.fixture(scope="session")
def recordings(recordings_folder):
    """Real records by name, each with its period in s."""
    tonic, walking = (
        recordings_folder / "tonic_ankle.mat",
        recordings_folder / "walking_ankle_small_reflex.mat",
    )

    def read(file, angle, torque):
        return tv.read_recording(
            file, angle=angle, torque=torque, sampling_rate=1000, torque_sign=-1
        )

    muscles = ("plantarflexor", "dorsiflexor", "dorsiflexor_2")
    return {
        "walking": (read(walking, "POSITION_SIGNAL", "TORQUE_SIGNAL"), 1.5),
        **{muscle: (read(tonic, f"{muscle}_angle", f"{muscle}_torque"), 2.0) for muscle in muscles},
    }
