"""The worker: one job waiting of each kind, the urgent kind first, failures survived."""

import threading

import pytest

from panodepth_ros.nodes.worker import Worker


class Jobs:
    """A worker whose jobs wait until they are let go, and what came of them."""

    def __init__(self):
        self.begun, self.go = threading.Semaphore(0), threading.Semaphore(0)
        self.done, self.failures = [], []
        self.worker = Worker('test', self.run, self.failures.append, ('urgent', 'idle'))

    def run(self, kind, job):
        self.begun.release()
        self.go.acquire()
        if isinstance(job, Exception):
            raise job
        self.done.append((kind, job))

    def let_go(self, count):
        for number in range(count):
            self.go.release()
            if number < count - 1:
                assert self.begun.acquire(timeout=20)


@pytest.fixture
def jobs():
    jobs = Jobs()
    yield jobs
    jobs.go.release(100)
    jobs.worker.close()


def test_newest_of_a_kind_takes_the_place_of_what_has_not_begun(jobs):
    assert not jobs.worker.put('idle', 1)
    assert jobs.begun.acquire(timeout=20)
    assert not jobs.worker.put('idle', 2), 'the first has begun'
    assert jobs.worker.put('idle', 3)
    assert not jobs.worker.put('urgent', 4), 'of another kind'
    jobs.let_go(3)
    jobs.worker.close()
    assert jobs.done == [('idle', 1), ('urgent', 4), ('idle', 3)]


def test_failure_is_handed_on_and_the_next_job_done(jobs):
    error = RuntimeError('broken')
    jobs.worker.put('idle', error)
    assert jobs.begun.acquire(timeout=20)
    jobs.worker.put('idle', 2)
    jobs.let_go(2)
    jobs.worker.close()
    assert jobs.failures == [error]
    assert jobs.done == [('idle', 2)]


def test_closing_forgets_what_waits(jobs):
    jobs.worker.put('idle', 1)
    assert jobs.begun.acquire(timeout=20)
    jobs.worker.put('idle', 2)
    closing = threading.Thread(target=jobs.worker.close)
    closing.start()
    jobs.worker._changed.acquire()
    jobs.worker._changed.wait_for(lambda: jobs.worker._closed)
    jobs.worker._changed.release()
    jobs.go.release(2)
    closing.join()
    assert jobs.done == [('idle', 1)]
