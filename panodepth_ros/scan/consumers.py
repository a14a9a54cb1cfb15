"""
What the consumers of a LaserScan do with it: rules on plain data, findings with reasons.

The rules are those of Nav2's costmap, AMCL and collision monitor, slam_toolbox, laser_geometry
and RViz, as their sources have them (docs/navigation.md). They hold for any LaserScan topic.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from panodepth_ros.scan.findings import CONSUMERS, Finding, ReceivedScan, ScanStream, Verdict

#: Transforms that Nav2 and slam_toolbox remember by default [s].
NAV2_MEMORY, SLAM_MEMORY = 10.0, 30.0
#: AMCL's default ``max_beams``; its beam model does not end below.
AMCL_BEAMS = 60
#: collision_monitor's default ``source_timeout`` [s].
SOURCE_TIMEOUT = 2.0
#: A sweep that lasts no longer may count as one moment, as a spinning lidar's does [s].
QUICK = 0.5
#: Computing a scan of a sweep may take that long; an older stamp tells another moment [s].
COMPUTING = 5.0
#: Stamps may lie that far ahead of the clock [s].
AHEAD = 0.1
#: Part of an increment by which ``angle_max`` may miss the last ray; float32 stays far below.
ANGLE_TOLERANCE = 0.1
#: A gap of +inf is no wider than this many beams if it is a failed measurement…
_GAP = 2
#: …and what stands on either side of it agrees within this share.
_GAP_AGREEMENT = 0.1
#: Share of the beams in such gaps that no room has.
_GAP_SHARE = 0.02


def check(stream: ScanStream) -> list[Finding]:
    """
    Hold a stream against every rule.

    Raises
    ------
    ValueError
        If there is no scan.
    """
    if not stream.scans:
        raise ValueError('no scan to check; allowed: at least one')
    return [rule(stream) for rule in RULES]


def by_consumer(findings: Sequence[Finding]) -> dict[str, tuple[Verdict, list[str]]]:
    """Worst verdict for each consumer, and the rules that gave it."""
    verdicts = {}
    for consumer in CONSUMERS:
        mine = [finding for finding in findings if consumer in finding.consumers]
        for verdict in (Verdict.FAIL, Verdict.UNKNOWN, Verdict.PASS):
            rules = [finding.rule for finding in mine if finding.verdict is verdict]
            if rules:
                verdicts[consumer] = (verdict, rules)
                break
    return verdicts


def rays_slam_toolbox_expects(scan: ReceivedScan) -> int:
    """How many ranges slam_toolbox computes from the angles; it rejects any other number."""
    span = abs(scan.angle_max - scan.angle_min)
    steps = round(span / scan.angle_increment)
    epsilon = float(np.finfo(np.float32).eps)
    full_turn = abs(span - 2 * math.pi) < scan.angle_increment - 2 * math.pi * epsilon
    if span > math.radians(350.0) and steps + 1 == scan.ranges.size:
        full_turn = False
    return steps + (not full_turn)


def _rays(stream: ScanStream) -> Finding:
    for scan in stream.scans:
        n, increment = scan.ranges.size, scan.angle_increment
        if not all(map(math.isfinite, scan.angles)) or not increment > 0:
            return Finding(
                'rays',
                Verdict.FAIL,
                f'angle_min {scan.angle_min:g}, angle_max {scan.angle_max:g}, angle_increment '
                f'{increment:g}; allowed: finite, and an increment above 0',
            )
        last = scan.angle_min + (n - 1) * increment
        missed = (scan.angle_max - last) / increment
        expected = rays_slam_toolbox_expects(scan)
        if abs(missed) > ANGLE_TOLERANCE:
            rejects = 'takes it, too' if expected == n else f'rejects it, expecting {expected}'
            return Finding(
                'rays',
                Verdict.FAIL,
                f'angle_max is {missed:+.2f} increments off the last of {n} rays; allowed: '
                f'angle_min + (N − 1)·increment. slam_toolbox {rejects}; others assert equality',
            )
        if n * increment > 2 * math.pi + ANGLE_TOLERANCE * increment:
            return Finding(
                'rays',
                Verdict.FAIL,
                f'{n} rays are more than a turn: the first direction is measured twice and may '
                f'hold two ranges; allowed: at most {round(2 * math.pi / increment)}',
            )
    return Finding(
        'rays', Verdict.PASS, f'{n} rays from angle_min to angle_max, no direction twice'
    )


def _constant(stream: ScanStream) -> Finding:
    first, *others = stream.scans
    who = ('amcl', 'slam_toolbox')
    for name, get in _REMEMBERED.items():
        for other in others:
            if get(other) != get(first):
                return Finding(
                    'constant',
                    Verdict.FAIL,
                    f'{name} changes from {get(first)} to {get(other)}: they keep what the first '
                    'scan told them and reject or misplace the rest',
                    who,
                )
    if not others:
        return Finding('constant', Verdict.UNKNOWN, 'one scan only: nothing to compare', who)
    return Finding(
        'constant', Verdict.PASS, f'{", ".join(_REMEMBERED)} equal in {len(stream.scans)}', who
    )


_REMEMBERED: dict[str, Callable[[ReceivedScan], object]] = {
    'N': lambda scan: scan.ranges.size,
    'angles': lambda scan: scan.angles,
    'range_min': lambda scan: scan.range_min,
    'range_max': lambda scan: scan.range_max,
    'frame_id': lambda scan: scan.frame_id,
}


def _beams(stream: ScanStream) -> Finding:
    n = min(scan.ranges.size for scan in stream.scans)
    if n >= AMCL_BEAMS:
        return Finding('beams', Verdict.PASS, f'{n} beams', ('amcl',))
    return Finding(
        'beams',
        Verdict.FAIL,
        f"{n} beams; allowed: at least {AMCL_BEAMS}. Below its max_beams AMCL's beam model steps "
        'by 0 and never ends',
        ('amcl',),
    )


def _range_limits(stream: ScanStream) -> Finding:
    for scan in stream.scans:
        if not 0 <= scan.range_min < scan.range_max < math.inf:
            return Finding(
                'range limits',
                Verdict.FAIL,
                f'range_min {scan.range_min:g} m, range_max {scan.range_max:g} m; allowed: '
                '0 <= range_min < range_max, finite. AMCL refuses or divides by it',
            )
        if scan.range_max <= stream.obstacle_max_range:
            return Finding(
                'range limits',
                Verdict.FAIL,
                f"range_max is {scan.range_max:g} m; allowed: above the costmap's "
                f'obstacle_max_range of {stream.obstacle_max_range:g} m, or with inf_is_valid '
                'the end of a +inf beam becomes an obstacle',
                ('costmap',),
            )
    return Finding('range limits', Verdict.PASS, f'{scan.range_min:g} to {scan.range_max:g} m')


def _values(stream: ScanStream) -> Finding:
    for scan in stream.scans:
        finite = scan.ranges[np.isfinite(scan.ranges)]
        below = int((finite < np.float32(scan.range_min)).sum())
        above = int((finite > np.float32(scan.range_max)).sum())
        if below or above:
            return Finding(
                'values',
                Verdict.FAIL,
                f'{below} numbers below range_min and {above} above range_max; allowed (REP-117): '
                'NaN unknown, −inf too near, +inf nothing there. AMCL takes what is too small '
                'for a maximum range',
                ('amcl', 'slam_toolbox', 'laser_geometry'),
            )
    return Finding('values', Verdict.PASS, 'every number lies within range_min and range_max')


def _unknown(stream: ScanStream) -> Finding:
    """What a beam that failed holds, as far as a scan tells: +inf in thin gaps is suspicious."""
    who = ('costmap', 'laser_geometry')
    beams = sum(scan.ranges.size for scan in stream.scans)
    nan = sum(int(np.isnan(scan.ranges).sum()) for scan in stream.scans)
    infinite = sum(int(np.isposinf(scan.ranges).sum()) for scan in stream.scans)
    gaps = sum(_beams_in_thin_gaps(scan.ranges) for scan in stream.scans)
    counts = f'of {beams} beams {nan} are NaN and {infinite} +inf'
    if not infinite:
        return Finding('unknown', Verdict.PASS, f'{counts}: nothing clears by mistake', who)
    if gaps == 0:
        reason = f'{counts}, none of these in a thin gap. Whether they looked cannot be told'
        return Finding('unknown', Verdict.PASS if nan else Verdict.UNKNOWN, reason, who)
    reason = (
        f'{counts}, {gaps} of these in gaps of at most {_GAP} beams between neighbours at one '
        'distance. If these are failed measurements they must be NaN: with inf_is_valid +inf '
        'clears obstacles'
    )
    wrong = not nan and gaps > _GAP_SHARE * beams
    return Finding('unknown', Verdict.FAIL if wrong else Verdict.UNKNOWN, reason, who)


def _beams_in_thin_gaps(ranges: npt.NDArray[np.floating]) -> int:
    finite = np.flatnonzero(np.isfinite(ranges))
    if finite.size < 2:
        return 0
    following = np.roll(finite, -1)
    width = (following - finite) % ranges.size - 1
    one, other = ranges[finite], ranges[following]
    thin = (width > 0) & (width <= _GAP) & (np.abs(one / other - 1) < _GAP_AGREEMENT)
    starts = finite[thin]
    inside = [np.isposinf(ranges[(starts + k) % ranges.size]) for k in range(1, _GAP + 1)]
    return int(sum((hit & (width[thin] >= k)).sum() for k, hit in enumerate(inside, 1)))


def _intensities(stream: ScanStream) -> Finding:
    who = ('laser_geometry', 'rviz')
    for scan in stream.scans:
        if scan.intensities not in (0, scan.ranges.size):
            return Finding(
                'intensities',
                Verdict.FAIL,
                f'{scan.intensities} intensities for {scan.ranges.size} ranges; allowed: none or '
                'one a range. They are read by the index of the range',
                who,
            )
    return Finding('intensities', Verdict.PASS, 'none, or one a range', who)


def _stamp(stream: ScanStream) -> Finding:
    oldest = max(scan.age for scan in stream.scans)
    newest = min(scan.age for scan in stream.scans)
    transforms = ('costmap', 'amcl', 'slam_toolbox', 'collision_monitor', 'rviz')
    hint = '' if oldest < 3600 else ' (a replay? set use_sim_time)'
    if oldest > NAV2_MEMORY:
        all_forget = oldest > SLAM_MEMORY
        who = tuple(who for who in transforms if all_forget or who != 'slam_toolbox')
        reason = (
            f'stamps are up to {oldest:.1f} s old on arrival{hint}; allowed: below '
            f'{NAV2_MEMORY:g} s (slam_toolbox {SLAM_MEMORY:g} s), for which transforms are kept. '
            'The scan is thrown away: "earlier than all the data in the transform cache"'
        )
        return Finding('stamp', Verdict.FAIL, reason, who)
    if newest < -AHEAD:
        reason = f'stamps are up to {-newest:.1f} s ahead of the clock; allowed: {AHEAD:g} s'
        return Finding('stamp', Verdict.FAIL, reason, transforms)
    slow = [scan for scan in stream.scans if scan.scan_time > 2 * QUICK]
    if any(scan.age > 0.9 * scan.scan_time for scan in slow):
        computed = oldest < COMPUTING
        tells = (
            'may tell its first ray, or computing took as long'
            if computed
            else 'tell its first ray'
        )
        reason = (
            f'stamps are {oldest:.1f} s old on arrival, as long as the sweep: they {tells}'
            '; allowed: the end of the sweep, while the robot stands still'
        )
        verdict = Verdict.UNKNOWN if computed else Verdict.FAIL
        return Finding('stamp', verdict, reason, transforms)
    stamps = [scan.stamp for scan in stream.scans]
    if any(b <= a for a, b in itertools.pairwise(stamps)):
        reason = 'stamps do not increase; allowed: a fresh stamp for every message'
        return Finding('stamp', Verdict.FAIL, reason, transforms)
    return Finding('stamp', Verdict.PASS, f'at most {oldest:.2f} s old on arrival', transforms)


def _time(stream: ScanStream) -> Finding:
    who = ('costmap', 'slam_toolbox', 'laser_geometry', 'rviz')
    for scan in stream.scans:
        sweep = scan.time_increment * scan.ranges.size
        if not (math.isfinite(sweep) and 0 <= sweep <= QUICK):
            return Finding(
                'time',
                Verdict.FAIL,
                f'time_increment is {scan.time_increment:g} s, {sweep:.3g} s a scan; allowed: 0 '
                f'for a sweep of a standing robot, at most {QUICK:g} s a scan otherwise. '
                'laser_geometry asks for transforms up to that long after the stamp; AMCL and '
                'slam_toolbox use one pose a scan',
                who,
            )
        if not (math.isfinite(scan.scan_time) and scan.scan_time >= 0):
            reason = f'scan_time is {scan.scan_time:g} s; allowed: finite, at least 0'
            return Finding('time', Verdict.FAIL, reason, who)
    return Finding('time', Verdict.PASS, f'{sweep:.3g} s from first to last ray', who)


def _period(stream: ScanStream) -> Finding:
    who = ('costmap', 'collision_monitor')
    received = [scan.received for scan in stream.scans]
    longest = max(
        [scan.scan_time for scan in stream.scans]
        + [b - a for a, b in itertools.pairwise(received)]
    )
    if longest <= SOURCE_TIMEOUT:
        return Finding('period', Verdict.PASS, f'a scan every {longest:.2f} s', who)
    reason = (
        f'up to {longest:.1f} s between scans: set source_timeout of collision_monitor '
        f'(default {SOURCE_TIMEOUT:g} s, then it ignores or stops) to 0.0 or above that, and '
        "leave the costmap's expected_update_rate at 0.0"
    )
    return Finding('period', Verdict.UNKNOWN, reason, who)


def _frame(stream: ScanStream) -> Finding:
    name = stream.scans[-1].frame_id
    who = ('costmap', 'amcl', 'slam_toolbox', 'collision_monitor', 'rviz')
    if not name or name.startswith('/'):
        reason = f'frame_id is {name!r}; allowed: a name without a leading slash'
        return Finding('frame', Verdict.FAIL, reason, who)
    fault, known = stream.motion.judge(name)
    if fault:
        return Finding('frame', Verdict.FAIL, fault, who)
    return Finding('frame', Verdict.PASS if known.certain else Verdict.UNKNOWN, known.text, who)


def _qos(stream: ScanStream) -> Finding:
    best_effort = [name for name, reliable in stream.reliable.items() if not reliable]
    if best_effort:
        reason = (
            f'{", ".join(best_effort)} publishes with best effort: RViz, which asks for reliable, '
            'gets nothing; allowed: reliable, which serves both'
        )
        return Finding('qos', Verdict.FAIL, reason, ('rviz',))
    if not stream.reliable:
        return Finding('qos', Verdict.UNKNOWN, 'no publisher is known any more')
    several = f' ({len(stream.reliable)} publishers)' if len(stream.reliable) > 1 else ''
    return Finding('qos', Verdict.PASS, f'reliable{several}')


RULES: tuple[Callable[[ScanStream], Finding], ...] = (
    _rays, _constant, _beams, _range_limits, _values, _unknown, _intensities, _stamp, _time,
    _period, _frame, _qos,
)  # fmt: skip
