"""
Panoramic depth from one camera on a rotating arm, for ROS 2.

``geometry``, ``mosaic``, ``matching`` and ``scan`` are the core: arrays in, arrays out, no ROS.
``arm`` and ``camera`` speak to devices, real or simulated. ``bag`` reads and writes recordings.
``ros`` holds parameters, message conversion and QoS; ``nodes`` is the wiring, one file a node.
``cli`` is the ``panodepth_ros`` command.
"""
