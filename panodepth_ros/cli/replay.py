"""``panodepth_ros replay``: the messages of a bag, published again."""

from __future__ import annotations

import argparse
import math
import threading
from pathlib import Path
from typing import Any

from panodepth_ros.cli.bags import run_until_stopped


def _rate(text: str) -> float:
    rate = float(text)
    if not (0.0 < rate < math.inf):
        raise ValueError
    return rate


def _remapping(text: str) -> tuple[str, str]:
    old, new = text.split(':=')
    if not old or not new:
        raise ValueError
    return old, new


def _subscribers(text: str) -> tuple[str, int]:
    topic, equals, count = text.partition('=')
    if not topic or (equals and int(count) < 1):
        raise ValueError
    return topic, int(count) if equals else 1


# argparse says "invalid … value" with the name of the function that raised.
_rate.__name__ = 'rate (a number above 0)'
_remapping.__name__ = 'remapping (old:=new)'
_subscribers.__name__ = 'topic (name or name=number)'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('bag', type=Path, help='folder of the bag, or one of its files')
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument('-r', '--rate', type=_rate, default=1.0, help='factor of speed (1.0)')
    pace.add_argument(
        '--asap',
        action='store_true',
        help='as fast as the subscribers take it, with nothing lost: at most one message per '
        'topic is under way, and the next follows when every subscribing node has taken it '
        '(nodes with a single-threaded executor and parameter services)',
    )
    parser.add_argument('--topics', nargs='+', default=[], metavar='topic', help='only these')
    parser.add_argument('--exclude', nargs='+', default=[], metavar='topic', help='not these')
    parser.add_argument(
        '--remap', nargs='+', default=[], type=_remapping, metavar='old:=new', help='rename topics'
    )
    parser.add_argument(
        '--wait-for',
        nargs='+',
        default=[],
        type=_subscribers,
        metavar='topic[=n]',
        help='begin when these topics, as published, have n subscribers (1); '
        'with --asap the default is one subscriber of every topic',
    )
    parser.add_argument('--clock', action='store_true', help="publish the bag's time on /clock")


def run(arguments: argparse.Namespace) -> int:
    """Replay to the end, or until SIGINT or SIGTERM; return the exit code."""

    def work(player: Any, stop: threading.Event) -> str:
        sent, total = player.replay(
            player.Replay(
                path=arguments.bag,
                topics=arguments.topics,
                exclude=arguments.exclude,
                remap=dict(arguments.remap),
                rate=arguments.rate,
                as_fast_as_possible=arguments.asap,
                wait_for=dict(arguments.wait_for),
                clock=arguments.clock,
            ),
            stop=stop,
        )
        return f'{arguments.bag}: sent {sent} of {total} messages'

    return run_until_stopped('replay', 'player', work)
