import pickle
import sys
import textwrap

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.methods import (
    describe,
    names,
    parse,
    to_text,
)
from tvsysid.numerics.bases import CubicBSplines

MODULE = '''
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import attrs
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


@attrs.frozen
class Needy(tv.Method):
    window: float
    order: int

    def fit(self, ensemble):
        return ensemble


class Nothing:
    pass


class Outer:
    Inner = Fit


def function(ensemble):
    return ensemble


ready = Fit(window=0.7)
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


@pytest.fixture
def installed(folder):
    """Offer entry points as an installed package does."""
    info = folder / "mypackage-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mypackage\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        textwrap.dedent("""\
            [tvsysid.methods]
            fit = mine_for_tests:Fit
            ready = mine_for_tests:ready
            needy = mine_for_tests:Needy
            gone = mine_for_tests:Gone
            missing = nowhere_for_tests:Fit
            failing = broken_for_tests:Fit
            sds = mine_for_tests:Fit
            """)
    )
    return folder


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("window=2", "window", 2.0),
        ("order=5", "order", 5),
        ("order=null", "order", None),
        ("band=[1, 30],order=2", "band", (1.0, 30.0)),
        ("robust=true", "robust", True),
        ("kind=slow", "kind", "slow"),
        ("name=5", "name", "5"),
    ],
)
def test_settings_get_the_types_of_the_fields(text, name, value):
    found = getattr(parse(f"mine_for_tests:Fit:{text}"), name)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.usefixtures("folder")
def test_settings_of_a_plain_class_have_the_types_of_its_arguments():
    assert parse("mine_for_tests:Outer.Inner").window == 0.1
    assert parse("mine_for_tests:ready:order=2").window == 0.7
    method = parse("mine_for_tests:Plain:gain=2,label=[1, 2]")
    assert (method.gain, method.label) == (2.0, [1, 2])
    assert type(method.gain) is float
    assert parse("mine_for_tests:Plain:label=some text").label == "some text"


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "nowhere_for_tests:Fit",
            r"module 'nowhere_for_tests' cannot be imported: ModuleNotFoundError: No module named",
        ),
        (
            "./mine_for_tests.py:Fit",
            r"a module is named without its folder and without \.py",
        ),
        (
            "mine_for_tests",
            r"unknown method 'mine_for_tests'; .* or your own as module:Object",
        ),
        (
            "broken_for_tests:Fit",
            r"module 'broken_for_tests' cannot be imported: ZeroDivisionError: division by zero "
            r"\(broken_for_tests\.py, line 3\)$",
        ),
        (
            "mine_for_tests:fit",
            r"has no 'fit'; its methods are Fit, Plain, Needy, ready",
        ),
        (
            "mine_for_tests:Nothing",
            r"Nothing is no tvsysid.Method",
        ),
        (
            "mine_for_tests:Fit:windw=1",
            r"unknown setting 'windw'; its settings are window, order, band, robust, kind, file, "
            r"weights, name",
        ),
        ("mine_for_tests:Fit:window=1,order", r"expected setting=value, got 'order'"),
        (
            "mine_for_tests:Fit:window=-1",
            r"ValueError: window must be positive \(mine_for_tests\.py, line 29\)",
        ),
    ],
)
def test_what_cannot_be_used_is_told(text, message):
    with pytest.raises(tv.InputError, match=message):
        parse(text)


@pytest.mark.usefixtures("installed")
def test_installed_methods_are_known_without_being_loaded():
    assert names() == (*tv.methods.METHODS, "failing", "fit", "gone", "missing", "needy", "ready")
    assert "mine_for_tests" not in sys.modules
    assert parse("fit:window=0.3,band=[1,2]").window == 0.3
    assert parse("ready").window == 0.7
    assert parse("sds") == tv.ShortDataSegments()  # the package's own comes first
    assert tv.study.Study(methods=["sds", "fit"]).named_methods["fit"] == parse("fit")


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "birf:basis=Haar(4)",
            r"'birf:basis=Haar\(4\)': expected a basis such as CubicBSplines\(functions=10\), of ",
        ),
        ("birf:basis=__import__('os').getcwd()", "expected a basis such as"),
        ("kbr:gamma=(1,2)", "gamma must be a positive number, or three"),
        ("lpv:rest_order=1.5", r"rest_order must be a whole number, got '1.5'"),
        ("sds:window=true", "window must be a number, got 'true'"),
    ],
)
def test_bases_and_several_numbers_that_cannot_be_read_are_told(text, message):
    with pytest.raises(tv.InputError, match=message):
        parse(text)


@pytest.mark.usefixtures("installed")
def test_description():
    sds = describe("sds")
    assert sds.title == "Short data segments"
    assert sds.settings == ("max_lag = 0.12", "window = 0.1")
    mine = describe("fit")
    assert (mine.title, mine.assumptions) == ("My fit", ("All is well.",))
    assert mine.settings[:3] == ("window = 0.1", "order = 3", "band = (0.0, 20.0)")
    assert describe("mine_for_tests:Plain") == (
        *("Plain", "repeated behaviour", (), ("stiffness", "viscosity", "inertia"), ()),
        ("gain = 1.0", "label = 'none'"),
    )
    assert describe("ready").settings[0] == "window = 0.7"


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
    assert not kbr.quantities
    assert pickle.loads(pickle.dumps(kbr)) == kbr
    experiment = tv.study.Experiment(virtual=1, methods=["kbr:tuned=true", "kbr"])
    assert all(each.method.contiguous for each in experiment.analyses)
