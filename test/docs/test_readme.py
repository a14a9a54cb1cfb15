"""What README shows works as it stands."""

import re
from pathlib import Path

import numpy as np

from panodepth_ros.camera.simulated import RoomCamera, furnished_room

README = Path(__file__).resolve().parents[2] / 'README.md'


def test_core_without_ros():
    (code,) = re.findall(r'```python\n(.*?)```', README.read_text(), re.DOTALL)
    camera = RoomCamera(width=160, height=120, fx=261.67, fy=261.67, cx=79.5, cy=59.5)
    room = furnished_room()
    azimuths = np.arange(360) * (2 * np.pi / 360)
    frames = [room.render(azimuth, camera, 0.30) for azimuth in azimuths]
    names = {'frames': frames, 'azimuths': azimuths}
    exec(code, names)
    found = names['ranges'][np.isfinite(names['ranges'])]
    assert found.size > 200
    assert 1.0 < np.median(found) < 4.0


def test_relative_links_lead_somewhere():
    targets = re.findall(r'\]\((?!http)([^)#]+)\)', README.read_text())
    assert targets
    assert [target for target in targets if not (README.parent / target).exists()] == []
