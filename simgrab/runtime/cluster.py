"""Share work among the machines of a Ray cluster, as `simgrab.runtime.processes` shares it among processes.

Ray is imported only when a cluster is used.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import threading
import uuid
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from typing import Any, TypeVar

from simgrab.errors import ClusterError, WorkerError, first_line
from simgrab.runtime import processes, versions
from simgrab.runtime.processes import DONE, RAISED, STOPS, TICK, Answer, Executor, Job, Pool

Item = TypeVar("Item")
T = TypeVar("T")

RETRIES = 5
"""Of an item whose process or machine died."""
AHEAD = 2
"""Items under way for each core of the cluster: one at work, and one that waits for it."""
_ANSWERS_S = 10.0
_ADVICE = "start one with `simgrab cluster up --local 2`, or with `ray start --head` and its address"


def open_pool(
    workers: int,
    cluster: str | None,
    *,
    setup: Callable[[], None] | None = None,
    environment: Mapping[str, str] | None = None,
    memory_bytes: int = 0,
    silent_s: float | None = None,
) -> Executor:
    """Open a `Pool` of processes, or a `ClusterPool` if a cluster is named; parameters as for both."""
    if cluster is None:
        return Pool(workers, setup=setup, environment=environment, silent_s=silent_s)
    return ClusterPool(cluster, setup=setup, environment=environment, memory_bytes=memory_bytes)


class ClusterPool(Executor):
    """The cores of a Ray cluster, as a pool of processes. Ray repeats the work of a process or machine that died.

    ``setup`` and ``environment`` are as for `Pool`. Raises `ClusterError` if there is no such cluster, or Ray is not
    installed or of another version than the cluster's.

    Parameters
    ----------
    address : str
        ``auto`` for the cluster that this machine is part of, ``ray://host:10001`` or ``host:6379``.
    memory_bytes : int
        Memory of each process; a machine gets no more items than fit into its memory.
    """

    def __init__(
        self,
        address: str,
        *,
        setup: Callable[[], None] | None = None,
        environment: Mapping[str, str] | None = None,
        memory_bytes: int = 0,
    ) -> None:
        _check_answers(address)
        self._ray = _ray()
        if self._ray.is_initialized():
            raise ClusterError("this program uses Ray already; call ray.shutdown() first")
        self._setup, self._memory = setup, memory_bytes
        runtime = {"env_vars": dict(environment)} if environment else None
        with _own_signals():
            try:
                self._ray.init(
                    address, runtime_env=runtime, log_to_driver=False, logging_level="ERROR",
                    configure_logging=False, namespace="simgrab",
                )  # fmt: skip
            except Exception as problem:  # ConnectionError, TimeoutError, RuntimeError of versions, of gRPC
                raise ClusterError(_unreached(address, problem)) from None

    def close(self) -> None:
        """Leave the cluster, which ends this pool's processes."""
        with _own_signals():
            self._ray.shutdown()

    def map(self, work: Callable[[Item], T], items: Iterable[Item], **options: Any) -> Generator[T, None, None]:
        """Call ``work`` for each item; see `Executor.map`. Ticks are counted once their item is done.

        Raises `ClusterError` if a machine has other versions than this one, or no machine has the memory.
        """
        self.check()
        ray = self._ray
        with self._reached():
            whole = uuid.uuid4().hex, versions.everything(), ray.cloudpickle.dumps((self._setup, work))
            self._order = ray.put(whole)
            self._task = ray.remote(_do).options(num_cpus=1, memory=self._memory or None, max_retries=RETRIES)
        yield from super().map(work, items, **options)

    def _room(self) -> int:
        with self._reached():
            return AHEAD * max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def _submit(self, _work: Callable[[Item], T], item: Item, _running: Collection[Any]) -> Any:
        with self._reached():
            return self._task.remote(self._order, item)

    def _answers(self, running: Mapping[Any, Job[Any]]) -> Iterator[Answer]:
        with self._reached():
            ready, _ = self._ray.wait(list(running), num_returns=1, timeout=5.0)  # a cluster may grow meanwhile
        for handle in ready:
            kind, value, steps = self._value(handle, running[handle].name)
            if steps:
                yield Answer(handle, TICK, steps)
            yield Answer(handle, kind, value)

    def _cancel(self, running: Collection[Any]) -> None:
        for handle in running:
            with contextlib.suppress(Exception):  # the cluster may be gone
                self._ray.cancel(handle, force=True)

    @contextlib.contextmanager
    def _reached(self) -> Iterator[None]:
        """Raise one line if Ray loses the cluster."""
        try:
            yield
        except (self._ray.exceptions.RayError, ConnectionError, TimeoutError) as problem:
            raise ClusterError(f"the cluster can no longer be reached ({first_line(problem)})") from None

    def check(self) -> None:
        """Refuse a cluster in which no machine can do an item: Ray would wait for one."""
        with self._reached():
            alive = [node for node in self._ray.nodes() if node["Alive"]]
        most = max((node["Resources"].get("memory", 0) for node in alive), default=0)
        if self._memory > most:
            raise ClusterError(
                f"no machine of the cluster has the {self._memory / 1e9:.1f} GB of memory that a process needs; "
                f"the largest has {most / 1e9:.1f} GB"
            )

    def _value(self, answer: Any, name: str) -> tuple[str, Any, int]:
        """Get what `_do` gave."""
        exceptions = self._ray.exceptions
        try:
            found: tuple[str, Any, int] = self._ray.get(answer)
        except exceptions.OutOfMemoryError:
            raise WorkerError(f"{name}: its process was ended repeatedly for lack of memory") from None
        except (exceptions.WorkerCrashedError, exceptions.NodeDiedError, exceptions.ObjectLostError) as problem:
            raise WorkerError(
                f"{name}: processes died processing it {RETRIES + 1} times ({first_line(problem)})"
            ) from None
        except exceptions.RayTaskError as problem:  # before it could begin, or after its end
            cause = problem.cause
            why = f"{type(cause).__name__}: {first_line(cause)}"
            raise ClusterError(
                f"{name}: a machine of the cluster cannot do it ({why}); install the same versions on all machines"
            ) from None
        except exceptions.RayError as problem:
            raise ClusterError(f"{name}: {first_line(problem)}") from None
        return found


_order = ""
_work: Callable[[Any], Any] | None = None
_problem: BaseException | None = None


def _do(order: tuple[str, dict[str, str], bytes], item: Any) -> Any:
    """Do an item in a process of the cluster; returns a kind, a value and the number of ticks.

    The work is unpickled only after the versions were compared.
    """
    global _order, _problem, _work
    number, wanted, pickled = order
    steps = 0

    def step() -> None:
        nonlocal steps
        steps += 1

    processes.call_on_tick(step)
    if _order != number:
        _order, _problem = number, _versions_problem(wanted)
        if _problem is None:
            setup, _work = processes.unpickled(pickled)
            _problem = processes.set_up(setup)
    try:
        if _problem is not None:
            raise _problem
        assert _work is not None
        return DONE, _work(item), steps
    except Exception as problem:
        return RAISED, processes.portable(problem), steps


def _versions_problem(wanted: dict[str, str]) -> ClusterError | None:
    here = versions.everything()
    differ = [
        f"{name} {here.get(name)} instead of {known}" for name, known in wanted.items() if here.get(name) != known
    ]
    if not differ:
        return None
    return ClusterError(
        f"the cluster's machine {socket.gethostname()} has {', '.join(differ)}: install the same on all machines"
    )


def _ray() -> Any:
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # what Ray will do, of which it warns
    os.environ.setdefault("RAY_DEDUP_LOGS_SKIP_REGEX", "(?s).*")  # else it prints pages of logs of each death
    try:
        import ray
        import ray.exceptions
    except ImportError as problem:
        raise ClusterError(f"a cluster needs Ray ({first_line(problem)}): pip install 'simgrab[cluster]'") from None
    return ray


def _check_answers(address: str) -> None:
    """Refuse an address at which nothing listens: Ray would wait for minutes."""
    if address == "auto":
        return
    found = re.fullmatch(r"(?:ray://)?(\[[0-9a-fA-F:.]+\]|[^/:\s]+):([0-9]{1,5})", address)
    if found is None:
        raise ClusterError(f"a cluster's address is auto, ray://HOST:10001 or HOST:6379, got {address!r}")
    try:
        socket.create_connection((found[1].strip("[]"), int(found[2])), _ANSWERS_S).close()
    except (OSError, OverflowError, UnicodeError) as problem:
        raise ClusterError(_unreached(address, problem)) from None


def _unreached(address: str, problem: Exception) -> str:
    text = str(problem)
    if "Version mismatch" in text or "version mismatch" in text:
        return f"the cluster at {address} has another version of Ray or Python: {' '.join(text.split())}"
    if address == "auto":
        return f"there is no Ray cluster on this machine; {_ADVICE}"
    return f"no Ray cluster answers at {address} ({first_line(problem)}); {_ADVICE}"


@contextlib.contextmanager
def _own_signals() -> Iterator[None]:
    """Restore this process's signal handlers, which Ray replaces."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in STOPS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def local_cluster(nodes: int, cores: int) -> Iterator[str]:
    """Run a cluster of nodes on this machine, for tests; yields its address. It ends when the context is left."""
    _ray()
    from ray.cluster_utils import Cluster

    with _own_signals():
        try:
            cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": cores, "include_dashboard": False})
        except Exception as problem:
            raise ClusterError(f"no cluster can be started here: {first_line(problem)}") from None
    try:
        with _own_signals():
            for _ in range(nodes - 1):
                cluster.add_node(num_cpus=cores)
        yield str(cluster.address)
    finally:
        with _own_signals():
            cluster.shutdown()
