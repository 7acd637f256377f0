import pytest
from toy_drive import make_drive


@pytest.fixture(scope="session")
def drive():
    return make_drive()
