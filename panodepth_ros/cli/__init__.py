"""The ``panodepth_ros`` command and the simulated arm's executable."""
