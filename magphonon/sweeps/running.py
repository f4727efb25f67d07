"""Points of a sweep are sent to an executor in batches; when a process dies, they are sent again.

A batch is long enough that sending it costs little, and short enough that little is lost with it.  Where the death of a process
breaks the executor, a new one is made.  Which point was to blame is not known, so all that were on their way become suspects:
they are sent again when the others are done, one by one, and half as many at a time after every further death.  A point with
which processes die twice while it is alone is recorded as a bad one.
"""

from __future__ import annotations

from collections import Counter, deque
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, wait
from contextlib import ExitStack
from typing import TYPE_CHECKING

from .evaluation import Answer, evaluated
from .executors import Here, in_flight

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from concurrent.futures import Future
    from typing import Any

BATCH_s = 0.2
"""Time that a batch should take."""
DEATHS = 2
"""Number of processes that died with one point alone, after which it is not tried again."""
FALSE_STARTS = 8
"""Number of executors that broke before the first answer, after which something else is wrong."""
DIED = 'every process that computed it died: out of memory, or a crash'


def completed(function: Callable[..., Any], points: Sequence[Mapping[str, float]], wanted: Sequence[int],
              executor: Executor | Callable[[], Executor] | None) -> Iterator[list[tuple[int, Answer]]]:
    """Answers as they come in.

    Parameters
    ----------
    function : callable
        Function whose keyword arguments are the keys of a point.
    points : sequence of dict
    wanted : sequence of int
        Numbers of the points to be answered.
    executor : Executor or callable that makes one, optional
        One that is given is left open; one that is made is closed, and made anew if it breaks.

    Yields
    ------
    list of (int, Answer)
        Numbers of points, with their answers, in the order in which they arrive.

    Raises
    ------
    BrokenExecutor
        If an executor breaks that cannot be made anew, or none ever answers.
    """
    queue, answered, breaks = _Queue(wanted), False, 0
    while queue:
        with ExitStack() as stack:
            pool = executor
            if not isinstance(pool, Executor):
                pool = stack.enter_context(pool() if pool is not None else Here())
            try:
                for answers in _answers(function, points, queue, pool):
                    answered = True
                    yield answers
            except BrokenExecutor as error:
                breaks += 1
                if pool is executor or (breaks >= FALSE_STARTS and not answered):
                    raise BrokenExecutor(f'the executor broke ({error}); what was answered before is in the journal, if there is '
                                         'one') from error
                if guilty := queue.broken():
                    yield [(k, Answer(fault=DIED)) for k in guilty]


def _answers(function, points, queue, pool):
    """Send batches to a pool until the queue is empty, yielding the answers."""
    width = in_flight(pool)
    while queue:
        while batch := queue.next_batch(width):
            try:
                queue.running[pool.submit(evaluated, function, [points[k] for k in batch])] = batch
            except BrokenExecutor:
                queue.waiting.extendleft(reversed(batch))
                raise
        done, _ = wait(queue.running, return_when=FIRST_COMPLETED)
        answers, broken = [], None
        for future in done:
            try:
                found, seconds = future.result()
            except BrokenExecutor as error:
                broken = error
                continue
            except Exception as error:
                if type(error).__name__ != 'KilledWorker':  # Dask's, of a task with which several workers died
                    raise
                answers += [(k, Answer(fault=DIED)) for k in queue.killed(future)]
                continue
            batch = queue.running.pop(future)
            queue.tune(len(batch), seconds)
            answers += zip(batch, found, strict=True)
        if answers:
            yield answers
        if broken is not None:
            raise broken


class _Queue:
    """Numbers of the points that wait, are suspects or are on their way."""

    def __init__(self, wanted: Sequence[int]) -> None:
        self.waiting, self.suspects = deque(wanted), deque[int]()
        self.deaths: Counter[int] = Counter()
        self.running: dict[Future[Any], list[int]] = {}
        self.size, self.most_suspects = 1.0, 1 << 30

    def __bool__(self) -> bool:
        return bool(self.waiting or self.suspects or self.running)

    def next_batch(self, width: int) -> list[int]:
        """The next points to be sent; none if `width` batches are on their way."""
        if self.waiting:
            count = min(int(self.size), -(-len(self.waiting) // width))
            return [self.waiting.popleft() for _ in range(count)] if len(self.running) < width else []
        few = len(self.running) < min(width, self.most_suspects)
        return [self.suspects.popleft()] if self.suspects and few else []

    def tune(self, points: int, seconds: float) -> None:
        """Make batches longer, step by step, until they take as long as they should; trust suspects more."""
        self.size = max(1.0, min(2 * self.size, BATCH_s * points / max(seconds, 1e-9)))
        self.most_suspects *= 2

    def broken(self) -> list[int]:
        """Make suspects of all that were on their way; returns those that are not to be tried again."""
        lost = [k for batch in self.running.values() for k in batch]
        alone = len(lost) == 1
        self.deaths.update(lost if alone else ())
        self.most_suspects = max(1, len(self.running) // 2)
        self.running = {}
        guilty = [k for k in lost if alone and self.deaths[k] >= DEATHS]
        self.suspects.extendleft(k for k in reversed(lost) if k not in guilty)
        return guilty

    def killed(self, future: Future[Any]) -> list[int]:
        """Of one batch with which processes died: its points become suspects; a single one is not to be tried again."""
        batch = self.running.pop(future)
        self.suspects.extend(batch if len(batch) > 1 else ())
        return batch if len(batch) == 1 else []
