import pytest
from tests.synthetic import results_of, summary_of


@pytest.fixture(scope="session")
def results():
    return results_of()


@pytest.fixture(scope="session")
def summary(results):
    return summary_of(results)
