"""
A simulated room for the camera on the arm, with exact truth.

``furnished`` puts a room together from ``furniture`` made of ``solids`` covered by ``textures``,
which ``patterns`` and ``paintings`` are for; ``room`` renders and measures it through the
``raytracer``, which asks ``hits`` where a ray meets a solid and ``shading`` for the colour there;
``lens`` adds distortion and a mount that is not true; ``truth`` is what a panorama of it should
tell.
"""

from panodepth_ros.camera.simulated.furnished import furnished_room
from panodepth_ros.camera.simulated.lens import RealCamera
from panodepth_ros.camera.simulated.room import Room, RoomCamera
from panodepth_ros.camera.simulated.truth import TruthPanorama, truth_panorama

__all__ = ['RealCamera', 'Room', 'RoomCamera', 'TruthPanorama', 'furnished_room', 'truth_panorama']
