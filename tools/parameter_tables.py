"""Write the nodes' parameter tables into docs/nodes.md, between their markers."""

from __future__ import annotations

import re
from pathlib import Path

from panodepth_ros.nodes.arm_settings import ArmDriverParameters
from panodepth_ros.nodes.calibrator_settings import CalibratorParameters
from panodepth_ros.nodes.camera_settings import CameraParameters
from panodepth_ros.nodes.check_scan import CheckScanParameters
from panodepth_ros.nodes.depth_settings import DepthParameters
from panodepth_ros.nodes.mosaicer_settings import MosaicerParameters
from panodepth_ros.nodes.views import ViewsParameters
from panodepth_ros.ros.parameters import markdown_table

DOCUMENT = Path(__file__).resolve().parents[1] / 'docs' / 'nodes.md'
TABLES = {
    'arm_driver': ArmDriverParameters,
    'camera': CameraParameters,
    'mosaicer': MosaicerParameters,
    'depth': DepthParameters,
    'calibrator': CalibratorParameters,
    'check_scan': CheckScanParameters,
    'views': ViewsParameters,
}


def with_tables(text: str) -> str:
    """
    Return a document with its parameter tables brought up to date.

    Raises
    ------
    ValueError
        If the markers of a node are missing.
    """
    for node, table in TABLES.items():
        begin, end = f'<!-- parameters of {node} -->', f'<!-- end of {node} -->'
        pattern = re.compile(f'{re.escape(begin)}\n.*?{re.escape(end)}', re.DOTALL)
        rows = markdown_table(table)
        places = pattern.findall(text)
        if len(places) != 1:
            raise ValueError(
                f'there are {len(places)} places for the parameters of {node}; allowed: 1'
            )
        text = pattern.sub(f'{begin}\n{rows}\n{end}'.replace('\\', r'\\'), text)
    return text


if __name__ == '__main__':
    DOCUMENT.write_text(with_tables(DOCUMENT.read_text()))
