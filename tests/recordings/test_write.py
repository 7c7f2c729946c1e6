import attrs
import numpy as np
import pytest
import xarray as xr
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.recordings import (
    load_ensemble,
    load_recording,
    whole_file,
    write_ensemble,
    write_models,
    write_recording,
    write_simulation,
)


@pytest.mark.parametrize("ending", [".mat", ".csv", ".tsv"])
def test_a_simulation_is_read_back(tmp_path, random, ending):
    columns = {"angle": random.normal(scale=0.01, size=200), "torque": random.normal(size=200)}
    file = tmp_path / f"deep/joint{ending}"
    write_simulation(file, columns, 100.0)
    recording = tv.read_recording(file, angle="angle", torque="torque", sampling_rate=100.0)
    np.testing.assert_allclose(recording.angle, columns["angle"], rtol=1e-8)
    np.testing.assert_allclose(recording.torque, columns["torque"], rtol=1e-8)
    assert [item.name for item in file.parent.iterdir()] == [file.name]


def test_models_are_read_back(tmp_path):
    ensemble = ensemble_of(duration=20.0)
    models = {key: tv.methods.parse(key).identify(ensemble) for key in ("esm", "birf")}
    about = {"file": "\udce9.mat", "delay": 0.5}
    write_models(tmp_path / "models.nc", models, ensemble, about)
    with xr.open_datatree(tmp_path / "models.nc", engine="h5netcdf") as tree:
        assert tree.attrs == {"file": "\\udce9.mat", "delay": 0.5}
        for key, model in models.items():
            written = tree[key]
            assert written.stiffness.attrs["units"] == "N m/rad"
            for name, values in model.to_xarray(ensemble).items():
                is_complex = np.iscomplexobj(values)
                found = written[f"{name}_real" if is_complex else name]
                np.testing.assert_array_equal(found, values.real)


def test_a_file_appears_whole_or_not_at_all(tmp_path):
    target = tmp_path / "table.csv"
    target.write_text("before")

    def lose_power():
        with whole_file(target) as file:
            file.write_text("half of it")
            raise RuntimeError("power lost")

    with pytest.raises(RuntimeError, match="lost"):
        lose_power()
    assert target.read_text() == "before"
    assert list(tmp_path.iterdir()) == [target]
    with whole_file(target) as file:
        file.write_text("after")
        assert target.read_text() == "before"
    assert target.read_text() == "after"


def assert_same(one, two):
    kept, back = (attrs.asdict(each, recurse=False) for each in (one, two))
    kept, back = kept | kept.pop("channels"), back | back.pop("channels")
    assert list(kept) == list(back)
    for name, value in kept.items():
        np.testing.assert_array_equal(value, back[name], strict=isinstance(value, np.ndarray))


# Some are names of other variables, some no plain words.
CHANNELS = ["emg", "Time", "trial_starts", "sv.Ankle (rad)", "", "µ/°", "a" * 80, "a" * 81]


@pytest.mark.parametrize("count", [1, 3])
def test_signals_are_read_back_unchanged(tmp_path, random, count):
    def signals(kind, *shape, **settings):
        angle, torque, *channels = random.normal(size=(10, *shape))
        shared = {"recorded_angle": random.normal(size=(*shape, count)), "delay_removed": 1e-3}
        shared["channels"] = dict(zip(CHANNELS[: 3 * count], channels, strict=False))
        return kind(angle, torque, 1e3 / 3, origin=-0.1, **shared, **settings)

    recording = signals(tv.Recording, 12, start=-1.5, trial_starts=(0, 4, 5)[:count])
    write_recording(tmp_path / "recording.nc", recording)
    assert_same(load_recording(tmp_path / "recording.nc"), recording)
    placed = {"onsets": random.normal(size=count), "trials": np.arange(count) + 2**31}
    cut = {"context": 2, "left_out": 3, "mean_subtracted": True}
    ensemble = signals(tv.Ensemble, count, 12, **placed, **cut)
    write_ensemble(tmp_path / "ensemble.nc", ensemble)
    assert_same(load_ensemble(tmp_path / "ensemble.nc"), ensemble)


def test_a_written_recording_is_a_file_like_others(tmp_path, random):
    angle, torque, emg = random.normal(scale=0.1, size=(3, 100))
    file = tmp_path / "ankle.nc"
    write_recording(file, tv.Recording(angle, torque, 100.0, channels={"emg": emg}))
    names = {"angle": "angle", "torque": "torque", "channels": {"emg": "emg"}}
    with pytest.warns(tv.DataQualityWarning, match="states 100 Hz, you gave 50 Hz"):
        found = tv.read_recording(file, **names, sampling_rate=50.0)
    np.testing.assert_array_equal(found.channels["emg"], emg)
    with pytest.raises(tv.InputError, match="not written by write_ensemble"):
        load_ensemble(file)
