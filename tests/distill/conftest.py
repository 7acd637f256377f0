import pytest
from toy_street import make_toy


@pytest.fixture(scope="session")
def toy():
    return make_toy()
