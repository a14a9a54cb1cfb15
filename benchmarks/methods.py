"""What is measured: the product's methods and OpenCV's as peers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np

from benchmarks.scenes import Scene
from panodepth_ros.geometry import Panorama
from panodepth_ros.matching import Correspondence, match
from panodepth_ros.matching.interface import GreyPair, grey_pair
from panodepth_ros.matching.opencv import match_by, whole_sixteens

SGBM_MODES = {
    'SGBM': cv2.STEREO_SGBM_MODE_SGBM,
    'SGBM_3WAY': cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    'HH': cv2.STEREO_SGBM_MODE_HH,
    'HH4': cv2.STEREO_SGBM_MODE_HH4,
}
PEERS = ('BM', *SGBM_MODES)
#: What is added to the name of a method that gets all panoramas of a sweep.
ALL_COLUMNS = ', all columns'


def peer_matcher(name: str, candidates: int) -> Any:
    """Matcher of OpenCV: block 5 (BM 9), left-right check within a column, uniqueness 10 %."""
    if name == 'BM':
        matcher = cv2.StereoBM.create(candidates, 9)
        matcher.setMinDisparity(1)
        matcher.setDisp12MaxDiff(1)
        matcher.setUniquenessRatio(10)
        return matcher
    return cv2.StereoSGBM.create(
        minDisparity=1,
        numDisparities=candidates,
        blockSize=5,
        P1=8 * 25,
        P2=32 * 25,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        mode=SGBM_MODES[name],
    )


@dataclass(frozen=True, slots=True)
class Method:
    """
    Something that matches.

    Attributes
    ----------
    name : str
    run : callable
        From a scene and a number of threads to a correspondence.
    """

    name: str
    run: Callable[[Scene, int], Correspondence]


def product_method(name: str, *, further: bool = False) -> Method:
    """One of the product's methods, on the pair alone or on all the sweep gives."""

    def run(scene: Scene, threads: int) -> Correspondence:
        others = scene.further if further else ()
        return match(scene.left, scene.right, further=others, method=name, threads=threads)

    return Method(f'{name}{ALL_COLUMNS}' if further else name, run)


def peer_method(name: str) -> Method:
    """One of OpenCV's matchers, made circular and given a confidence by the product."""

    def run(scene: Scene, threads: int) -> Correspondence:
        pair = grey_pair(scene.left, scene.right)
        return match_by(pair, peer_matcher(name, whole_sixteens(pair)))

    return Method(f'OpenCV {name}', run)


def bare_peer(name: str, left: Panorama, right: Panorama) -> Callable[[], Any]:
    """OpenCV's own part alone, on the grey pair as it is: the least time a user can spend."""
    pair: GreyPair = grey_pair(left, right)
    images = [np.ascontiguousarray(image[:, ::-1]) for image in (pair.left, pair.right)]
    return partial(peer_matcher(name, whole_sixteens(pair)).compute, *images)
