"""
Bags: read without ROS; record and replay with it.

The files are those of ``ros2 bag`` (MCAP or sqlite3), read and written by the Python package
rosbags. ``storage`` holds files, ``recorder`` and ``player`` the nodes.
"""

from panodepth_ros.bag.storage import STORAGES, BagError, BagWriter, read

__all__ = ['STORAGES', 'BagError', 'BagWriter', 'read']
