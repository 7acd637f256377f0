import pytest

from generator.wan.tiny import write_tiny_backbone


@pytest.fixture(scope="session")
def backbone_folder(tmp_path_factory):
    """A Wan2.1-VACE folder of toy size."""
    folder = tmp_path_factory.mktemp("wan") / "backbone"
    write_tiny_backbone(folder)
    return folder
