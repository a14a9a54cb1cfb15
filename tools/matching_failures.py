"""Draw where the semi-global matching fails in a simulated room, for docs/matching.md."""

from __future__ import annotations

import argparse

import cv2
import numpy as np

from panodepth_ros.matching import match
from tools.fit_confidence import WIDTH, panorama, photographed, swept

#: Blue, green, red.
RIGHT, UNMATCHED, WRONG = (255, 255, 255), (170, 170, 170), (0, 0, 220)


def main() -> None:
    """Sweep a room, match it, draw panorama, disparity and errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seed', type=int, default=107)
    parser.add_argument('--noise', type=float, default=1.5, help='[grey levels]')
    parser.add_argument('--least-confidence', type=float, default=0.5)
    parser.add_argument('--output', default='matching_failures.jpg')
    arguments = parser.parse_args()
    (left, right), truth, (_, angle) = swept(arguments.seed, [150, WIDTH - 1 - 150])
    rng = np.random.default_rng(arguments.seed)
    look = {'noise': arguments.noise, 'contrast': 1.0, 'gain': 1.0}
    left, right = photographed(left, look, rng), photographed(right, look, rng)
    found = match(panorama(left, -angle), panorama(right, angle), method='semiglobal')
    kept = found.confidence >= arguments.least_confidence
    disparity = np.where(kept, found.column_disparity, np.nan)
    low, high = np.nanpercentile(truth, (1, 99))
    shades = np.clip((disparity - low) / (high - low), 0, 1)
    coloured = cv2.applyColorMap(
        np.nan_to_num(255 * (1 - shades)).astype(np.uint8), cv2.COLORMAP_TURBO
    )
    coloured[~kept] = UNMATCHED
    errors = np.full_like(left, RIGHT)
    errors[~kept] = UNMATCHED
    errors[kept & (np.abs(disparity - truth) > 1)] = WRONG
    picture = np.concatenate([left, coloured, errors])
    half = picture.shape[1] // 2
    stacked = np.concatenate([picture[:, :half], picture[:, half : 2 * half]])
    if not cv2.imwrite(arguments.output, stacked):
        raise SystemExit(f'could not write {arguments.output}')
    wrong = np.abs(disparity - truth)[kept] > 1
    print(f'kept {kept.mean():.3f} of all pixels, {wrong.mean():.3f} of them wrong')


if __name__ == '__main__':
    main()
