"""The file of a sweep under way, where the disk does not do what is asked of it."""

import pytest

from panodepth_ros.nodes.keeping import SweepKeeper

pytestmark = pytest.mark.ros


def test_file_that_cannot_be_removed_is_told_and_ends_nothing(ros, tmp_path, capfd):
    path = tmp_path / 'state'
    keeper = SweepKeeper(ros.node(), str(path))
    path.mkdir()  # as little to be removed as a file on a disk that is read-only now
    keeper.forget()
    assert not keeper.pending
    assert 'state_file cannot be removed' in capfd.readouterr().err
