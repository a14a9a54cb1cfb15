"""Injects faults into one graph, waits for what comes of them and judges it."""

from __future__ import annotations

import math
import multiprocessing
import re
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from benchmarks.faults.faults import FAULTS, Fault
from benchmarks.faults.graph import COLUMNS, Graph
from benchmarks.faults.judge import WRONG_SCAN, Judge
from benchmarks.faults.lifetime import die_with_parent
from panodepth_ros.cli.domain import claimed_domain

#: A sweep hangs that gets no column, has not ended and was not given up for this time [s], or that
#: goes on like that for long after the fault.
HANG, LONGEST = 30.0, 90.0
#: Time that a graph gets to start [s]; the first one compiles the matching.
START = 120.0
#: An arm this far off from its count has to be put right [rad].
_TURNED = math.radians(0.1)


@dataclass(slots=True)
class Outcome:
    """
    What came of one injection.

    Attributes
    ----------
    fault : str
        Name of the fault.
    moment : float
        Share of the sweep at which it came.
    ended : str
        ``scan``, ``given up`` or ``hang``.
    person : bool
        Whether a person had to home the arm, or to put it right, before the next sweep.
    wrong : int
        Published results that were not true.
    lost : int
        Columns unknown in the published panoramas.
    took : float
        From the fault to the end of the sweep [s].
    said : str
        Why the sweep was given up, or what was wrong.
    """

    fault: str
    moment: float
    ended: str = 'scan'
    person: bool = False
    wrong: int = 0
    lost: int = 0
    took: float = 0.0
    said: str = ''


class Campaign:
    """Injects faults into one graph and judges what comes of them."""

    def __init__(self, graph: Graph, judge: Judge) -> None:
        self._graph = graph
        self._judge = judge

    def inject(self, fault: Fault, rng: np.random.Generator) -> Outcome:
        """Run a sweep with one fault in it."""
        graph = self._graph
        moment = float(rng.uniform(0.0, 0.95))
        outcome = Outcome(fault.name, moment)
        why = graph.begin_sweep(HANG)
        if why:
            outcome.ended, outcome.said = 'hang', f'no sweep could be begun: {why}'
            return outcome
        graph.until(lambda: graph.share > moment or graph.given_up, HANG)
        graph.wait(float(rng.uniform(0.0, 0.06)))
        began = time.monotonic()
        fault.disturb(graph, rng)
        if not self._ends():
            outcome.ended = 'hang'
            outcome.said = f'at {graph.share:.0%}: {graph.log("mosaicer")[-300:]}'
            graph.call('mosaicer/cancel')
        outcome.took = time.monotonic() - began
        graph.wait(0.1)  # the log comes after the message
        if graph.given_up and outcome.ended != 'hang':
            outcome.ended = 'given up'
            outcome.said = (re.findall(r'sweep given up.*?: (.*)', graph.log('mosaicer')) or [''])[
                -1
            ]
        self._judge_scans(outcome, in_any_light=fault.changes_light)
        graph.restore()
        outcome.person = self.see_to_arm()
        return outcome

    def _ends(self) -> bool:
        """Whether the sweep ends in time."""
        graph = self._graph
        deadline = time.monotonic() + LONGEST
        while not (graph.scans or graph.given_up):
            heard = len(graph.progress)
            graph.until(partial(self._goes_on, heard), HANG)
            if time.monotonic() > deadline or not self._goes_on(heard):
                return False
        return True

    def _goes_on(self, heard: int) -> bool:
        return bool(self._graph.scans) or len(self._graph.progress) > heard

    def _judge_scans(self, outcome: Outcome, *, in_any_light: bool) -> None:
        for result in self._graph.scans:
            error, said = self._judge.scan_error(result['scan']), ''
            columns = [
                self._judge.wrong_columns(
                    result[f'{eye}/image'],
                    result[f'{eye}/camera_info'],
                    in_any_light=in_any_light,
                )
                for eye in ('left', 'right')
            ]
            wrong, lost = (max(counts) for counts in zip(*columns, strict=True))
            outcome.lost = max(outcome.lost, lost)
            if wrong:
                said = f'{wrong} columns of another place'
            elif error > WRONG_SCAN and lost < COLUMNS // 2:
                said = f'median error {error:.2f}'
            if said:
                outcome.wrong += 1
                outcome.said = f'{said}; {outcome.said}'

    def see_to_arm(self) -> bool:
        """Home the arm if its driver wants that, and put it where its count says, as a person."""
        graph = self._graph
        if graph.given_up:
            graph.call('arm_driver/stop')  # an arm in trouble stays held until somebody says so
        ready = graph.arm_is_ready()
        if not ready:
            graph.until(lambda: graph.call('arm_driver/home').success, HANG)
        turned: list[float] = []
        graph.arm.do(lambda controller, _: turned.append(controller.put_right()))
        return not ready or abs(turned[0]) > _TURNED


def compresses(number: int) -> bool:
    """Whether a graph compresses its frames: every other one."""
    return number % 2 == 1


def _outcomes(number: int, names: Sequence[str], seed: int, end: float) -> list[Outcome]:
    faults = {fault.name: fault for fault in FAULTS}
    rng = np.random.default_rng([seed, number])
    outcomes: list[Outcome] = []
    judge = Judge(number)  # takes long; the simulated arm, of this process too, has to answer
    with claimed_domain() as domain, tempfile.TemporaryDirectory() as folder:
        graph = Graph(Path(folder), domain, judge.look, seed=number, compresses=compresses(number))
        try:
            graph.until(lambda: 'ready' in graph.log('depth'), START)
            campaign = Campaign(graph, judge)
            campaign.see_to_arm()
            for name in names:
                if time.monotonic() > end:
                    break
                outcome = campaign.inject(faults[name], rng)
                outcomes.append(outcome)
                print(
                    f'{number}: {name} at {outcome.moment:.0%}: {outcome.ended}, '
                    f'{outcome.lost} lost, {outcome.wrong} wrong, {outcome.took:.1f} s'
                    f'{", person" if outcome.person else ""} {outcome.said}',
                    flush=True,
                )
        finally:
            graph.close()
    return outcomes


def start_graph(number: int, names: Sequence[str], seed: int, end: float) -> Connection:
    """
    Run one graph through faults until a time [s, monotonic], in a process of its own.

    Its outcomes arrive together at the end; it ends with this process.
    """
    context = multiprocessing.get_context('spawn')
    report, sender = context.Pipe(duplex=False)
    context.Process(target=_run, args=(sender, number, names, seed, end), daemon=True).start()
    sender.close()
    return report


def _run(report: Connection, number: int, names: Sequence[str], seed: int, end: float) -> None:
    def leave(*_: object) -> None:
        for each in ends:
            signal.signal(each, signal.SIG_IGN)
        sys.exit(1)

    ends = signal.SIGINT, signal.SIGTERM
    for each in ends:
        signal.signal(each, leave)
    die_with_parent(signal.SIGTERM)
    report.send(_outcomes(number, names, seed, end))
    for each in ends:  # the campaign ends what is about to end by itself
        signal.signal(each, signal.SIG_IGN)
