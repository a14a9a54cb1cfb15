"""
Panoramic depth from one camera on a rotating arm, for ROS 2.

``geometry``, ``mosaic``, ``matching`` and ``scan`` are the core: arrays in, arrays out, no ROS.
``arm`` and ``camera`` speak to devices, real or simulated. ``bag`` reads and writes recordings.
``ros`` holds parameters, message conversion and QoS; ``nodes`` is the wiring, one file a node.
``cli`` is the ``panodepth_ros`` command.
"""

import os

# Before OpenCV is imported: damaged bytes may claim a picture of a thousand megapixels, and it
# would make room for them. 8192 × 8192 is enough for any camera.
os.environ.setdefault('OPENCV_IO_MAX_IMAGE_PIXELS', str(2**26))
