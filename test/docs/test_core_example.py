"""The example of the core without ROS works as it stands."""

import re

import numpy as np
from documents import ROOT

from panodepth_ros.camera.simulated import RoomCamera, furnished_room


def test_core_without_ros():
    text = (ROOT / 'docs' / 'architecture.md').read_text()
    (code,) = re.findall(r'```python\n(.*?)```', text, re.DOTALL)
    camera = RoomCamera(width=160, height=120, fx=261.67, fy=261.67, cx=79.5, cy=59.5)
    room = furnished_room()
    azimuths = np.arange(360) * (2 * np.pi / 360)
    frames = [room.render(azimuth, camera, 0.30) for azimuth in azimuths]
    names = {'frames': frames, 'azimuths': azimuths}
    exec(code, names)
    found = names['ranges'][np.isfinite(names['ranges'])]
    assert found.size > 200
    assert 1.0 < np.median(found) < 4.0
