import pytest
from matplotlib import pyplot
from tests.experimental import experiment_of
from tests.synthetic import results_of, summary_of


@pytest.fixture(scope="session")
def results():
    return results_of()


@pytest.fixture(scope="session")
def experiment():
    return experiment_of()


@pytest.fixture(scope="session")
def summary(results):
    return summary_of(results)


@pytest.fixture(autouse=True)
def _closed():
    yield
    pyplot.close("all")
