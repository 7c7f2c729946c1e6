"""Methods, systems, profiles and perturbations by name, with settings as text."""

import pickle
import sys

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.methods import describe, expand, from_text, label_of, load, parse, to_text
from tvsysid.numerics.bases import CubicBSplines

MODULE = '''
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tvsysid as tv


@dataclass(frozen=True)
class Fit(tv.Method):
    """A method with every kind of setting."""

    window: float = 0.1
    order: int | None = 3
    band: tuple[float, float] = (0.0, 20.0)
    robust: bool = False
    kind: Literal["fast", "slow"] = "fast"
    file: Path = Path(".")
    weights: np.ndarray | None = None
    name: str = ""

    title = "My fit"
    assumptions = ("All is well.",)

    def __post_init__(self):
        if self.window <= 0:
            raise ValueError("window must be positive")

    def fit(self, ensemble):
        return ensemble


class Plain(tv.Method):
    def __init__(self, gain: float = 1.0, label="none"):
        self.gain, self.label = gain, label

    def fit(self, ensemble):
        return ensemble


class Outer:
    Inner = Fit


ready = Fit(window=0.7)


@dataclass(frozen=True)
class Joint:
    viscosity: float = 2.2

    def simulate(self, duration, perturbation, snr_db, seed, rate=1000.0):
        return self


def profile(time):
    return 100 + 0 * time


class Steps:
    def generate(self, samples, rate, random):
        return random.standard_normal(samples)
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Folder on the path with a module of methods."""
    (tmp_path / "mine_for_tests.py").write_text(MODULE)
    (tmp_path / "broken_for_tests.py").write_text("first = 1\n\nratio = first / 0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in [name for name in sys.modules if name.endswith("_for_tests")]:
        del sys.modules[name]


def test_an_installed_package_names_its_methods(folder):
    info = folder / "mypackage-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mypackage\nVersion: 1.0\n")
    points = "fit = mine_for_tests:Fit\nsds = mine_for_tests:Fit\n"
    (info / "entry_points.txt").write_text(f"[tvsysid.methods]\n{points}")
    assert parse("fit:window=2").window == 2.0
    assert isinstance(parse("sds"), tv.ShortDataSegments)  # the package's own key comes first
    assert expand(["all"])[-1] == "fit"


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("Fit:window=2", "window", 2.0),
        ("Fit:order=5", "order", 5),
        ("Fit:order=null", "order", None),
        ("Fit:band=[1, 30],order=2", "band", (1.0, 30.0)),
        ("Fit:robust=true", "robust", True),
        ("Fit:kind=slow", "kind", "slow"),
        ("Fit:name=5", "name", "5"),
        ("Outer.Inner", "window", 0.1),
        ("ready:order=2", "window", 0.7),
        ("Plain:gain=2,label=[1, 2]", "gain", 2.0),
        ("Plain:gain=2,label=[1, 2]", "label", [1, 2]),
        ("Plain:label=some text", "label", "some text"),
    ],
)
def test_settings_get_the_types_of_the_fields(text, name, value):
    found = getattr(parse(f"mine_for_tests:{text}"), name)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("nowhere_for_tests:Fit", "method", r"ModuleNotFoundError: No module named"),
        ("./mine_for_tests.py:Fit", "method", r"is named without its folder and without \.py"),
        (
            "mine_for_tests",
            "method",
            r"unknown method 'mine_for_tests'; .* or your own as module:Object",
        ),
        (
            "broken_for_tests:Fit",
            "method",
            r"ZeroDivisionError: division by zero \(broken_for_tests\.py, line 3\)$",
        ),
        ("mine_for_tests:fit", "method", r"has no attribute 'fit'"),
        ("mine_for_tests:Outer", "method", r"is no tvsysid.Method"),
        (
            "mine_for_tests:Fit:windw=1",
            "method",
            r"unknown setting 'windw'; its settings are window, order, band, robust, kind, file, "
            r"weights, name",
        ),
        ("mine_for_tests:Fit:window=1,order", "method", r"expected setting=value, got 'order'"),
        (
            "mine_for_tests:Fit:window=-1",
            "method",
            r"ValueError: window must be positive \(mine_for_tests\.py, line 28\)",
        ),
        (
            "birf:basis=Haar(4)",
            "method",
            r"'birf:basis=Haar\(4\)': expected a basis such as CubicBSplines\(functions=10\), of ",
        ),
        ("birf:basis=__import__('os').getcwd()", "method", "expected a basis such as"),
        ("kbr:gamma=(1,2)", "method", "gamma must be a positive number, or three"),
        ("lpv:rest_order=1.5", "method", r"rest_order must be a whole number, got '1.5'"),
        ("sds:window=true", "method", "window must be a number, got 'true'"),
        ("mine_for_tests:Steps", "system", r"^system 'mine_for_tests:Steps' has no simulate"),
        ("mine_for_tests:profile:a=1", "profile", r"unknown setting 'a'"),
        (
            "mine_for_tests:Joint:viscosity=low",
            "system",
            r"^system .*: viscosity must be a number, got 'low'",
        ),
    ],
)
def test_what_cannot_be_used_is_told(text, kind, message):
    with pytest.raises(tv.InputError, match=message):
        from_text(text, kind)


@pytest.mark.usefixtures("folder")
def test_systems_profiles_and_perturbations_of_ones_own():
    module = "mine_for_tests"
    assert from_text(f"{module}:Joint:viscosity=3", "system").viscosity == 3.0
    assert from_text(f"{module}:profile", "profile") is load(f"{module}:profile")
    assert type(from_text(f"{module}:Steps", "perturbation")).__name__ == "Steps"


@pytest.mark.parametrize(
    ("item", "label"),
    [("sds:window=0.2", "sds:window=0.2"), (tv.ShortDataSegments(), None), (object(), "object")],
)
def test_label_in_results(item, label):
    assert label_of(item) == (label or repr(item))


@pytest.mark.parametrize(
    "method",
    [
        tv.ShortDataSegments(max_lag=0.06, window=0.02),
        tv.BasisIRF(basis=CubicBSplines(20, periodic=True), prior="ridge"),
        tv.KernelRegression(
            length_periodic=0.005646, gamma=(0.9495, 4.475e-07, 1.321e-15), band=(0.5, 20.0)
        ),
    ],
)
def test_what_is_typed_makes_the_same_method(method):
    assert parse(to_text(method)) == method


@pytest.mark.usefixtures("folder")
def test_description():
    sds = describe("sds")
    assert sds.title == "Short data segments"
    assert sds.settings == ("max_lag = 0.12", "window = 0.1", "reference = None")
    mine = describe("mine_for_tests:Fit")
    assert (mine.title, mine.assumptions) == ("My fit", ("All is well.",))
    assert describe("mine_for_tests:Plain") == (
        *("Plain", "repeated movements", (), ("stiffness", "viscosity", "inertia"), ()),
        ("gain = 1.0", "label = 'none'"),
    )


def test_channels_and_skip_are_checked_wherever_a_method_begins():
    with pytest.raises(tv.InputError, match=r"Input: kind must be one of 'input', .* got 'Input'"):
        tv.Input("emg", "Input", "V")

    class Driven(tv.BasisIRF):
        inputs = (tv.Input("emg", "input", "V"),)

        def skip(self, ensemble):
            return "it has too few" if len(ensemble) < 5 else None

    whole = attrs.evolve(ensemble_of(), channels={"emg": ensemble_of().torque})
    for ensemble, told in (
        (ensemble_of(), "it needs the channel 'emg'"),
        (whole.select([1, 2]), "it has too few"),
    ):
        for begin in (Driven().identify, Driven().tuned):
            with pytest.raises(tv.InputError, match=f"Driven: {told}"):
                begin(ensemble)
        tuned = tv.methods.Tuned(Driven())
        assert tv.methods.reason_to_skip(tuned, ensemble).startswith(told)


def test_every_attribute_of_a_method_has_a_default():
    class Mine(tv.Method):
        def fit(self, ensemble):
            return tv.Model.of(ensemble, 100.0)

    method = Mine()
    assert (method.key, method.title, repr(method)) == ("mine", "Mine", "Mine")
    assert not any((method.inputs, method.quantities, method.pathway_names, method.can_be_tuned))
    model = method.identify(ensemble_of())
    assert (model.method, set(model.estimates)) == ("Mine", {"stiffness"})
    np.testing.assert_array_equal(
        model.predict(ensemble_of()), 100.0 * ensemble_of().derivatives()[0]
    )
    with pytest.raises(tv.InputError, match="Mine has no settings that can be chosen"):
        method.tuned(ensemble_of())


def test_a_tuned_method_says_of_itself_what_the_method_says():
    kbr = tv.methods.parse("kbr:tuned=true")
    assert kbr.contiguous
    assert not tv.methods.parse("birf:tuned=true").contiguous
    assert pickle.loads(pickle.dumps(kbr)) == kbr
    experiment = tv.study.Experiment(virtual=1, methods=["kbr:tuned=true", "kbr"])
    assert all(each.method.contiguous for each in experiment.analyses)
