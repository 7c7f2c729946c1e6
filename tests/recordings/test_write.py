import numpy as np
import pytest
import xarray as xr

import tvsysid as tv
from tvsysid.recordings import whole_file, write_models, write_simulation


@pytest.mark.parametrize("ending", [".mat", ".csv", ".tsv"])
def test_a_simulation_is_read_back(tmp_path, random, ending):
    columns = {"angle": random.normal(scale=0.01, size=200), "torque": random.normal(size=200)}
    file = tmp_path / f"deep/joint{ending}"
    write_simulation(file, columns, 100.0)
    recording = tv.read_recording(file, angle="angle", torque="torque", sampling_rate=100.0)
    np.testing.assert_allclose(recording.angle, columns["angle"], rtol=1e-8)
    np.testing.assert_allclose(recording.torque, columns["torque"], rtol=1e-8)
    assert [item.name for item in file.parent.iterdir()] == [file.name]


def test_an_unknown_ending_is_refused(tmp_path):
    with pytest.raises(tv.InputError, match=r"give one of .mat, .csv, .tsv"):
        write_simulation(tmp_path / "joint.xlsx", {"angle": np.zeros(3)}, 100.0)


def test_models_are_read_back(tmp_path, ensemble_of):
    models = {key: tv.methods.create(key).identify(ensemble_of(150.0)) for key in tv.methods.METHODS}
    write_models(tmp_path / "models.nc", models)
    with xr.open_datatree(tmp_path / "models.nc", engine="h5netcdf") as tree:
        assert set(tree.children) == set(models)
        for key, model in models.items():
            np.testing.assert_array_equal(tree[key].stiffness.values, model.stiffness)
            assert tree[key].stiffness.attrs["units"] == "N m/rad"
            assert tree[key].attrs["method"] == model.method
        response = tree["esm"].frequency_response_real.values + 1j * tree["esm"].frequency_response_imag.values
        np.testing.assert_array_equal(response, models["esm"].frequency_response)
        np.testing.assert_array_equal(tree["sds"].impulse_response.values, models["sds"].impulse_response)
        np.testing.assert_array_equal(tree["birf"].covariance.values, models["birf"].covariance)


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
