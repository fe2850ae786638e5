import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from duospacenet.runtime import termination
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.onnxruntime_session import set_thread_pool_size
from duospacenet.runtime.session import to_tensors
from duospacenet.runtime.termination import terminable, terminate_calls
from tests.helpers.processes import popen, wait_for
from tests.helpers.slow_graphs import slow_session

LIMIT_S = 60  # far less than the runs would take, and enough for a busy machine


def test_a_run_in_another_thread_ends_and_the_session_can_run_again():
    set_thread_pool_size(available_cores())
    session = slow_session("endless loop")
    with ThreadPoolExecutor(1) as threads:
        for _ in range(2):
            run = threads.submit(session.run, to_tensors(x=np.ones((1, 1), np.float32)))
            wait_for(lambda: len(termination._stops) == 1)
            assert not run.done()
            terminate_calls()
            with pytest.raises(KeyboardInterrupt):
                run.result(timeout=LIMIT_S)
    assert not termination._stops
    outputs = session.run(to_tensors(x=np.zeros((1, 1), np.float32)))  # the loop has no iteration
    assert outputs["y"].numpy() == 0


def test_all_runs_in_progress_end():
    set_thread_pool_size(available_cores())
    sessions = [slow_session("endless loop") for _ in range(3)]
    with ThreadPoolExecutor(3) as threads:
        runs = [threads.submit(session.run, to_tensors(x=np.ones((1, 1), np.float32))) for session in sessions]
        wait_for(lambda: len(termination._stops) == 3)
        terminate_calls()
        for run in runs:
            with pytest.raises(KeyboardInterrupt):
                run.result(timeout=LIMIT_S)


def test_a_failure_without_a_stop_keeps_its_exception():
    with pytest.raises(ValueError, match="broken"), terminable(lambda: None):
        raise ValueError("broken")
    assert not termination._stops


def test_a_call_that_ends_before_it_is_stopped_returns_normally():
    with terminable(lambda: None):
        terminate_calls()
    assert not termination._stops


SIGNALLED_RUN = """
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from duospacenet.cli.interruptions import catch_interruptions
from duospacenet.runtime.onnxruntime_session import set_thread_pool_size
from duospacenet.runtime.session import to_tensors
from tests.helpers.slow_graphs import slow_session

catch_interruptions()
set_thread_pool_size(1)
session = slow_session({kind!r})
tensors = to_tensors(x=np.full(session._session.get_inputs()[0].shape, 1e-3, np.float32))

def run():
    with ThreadPoolExecutor(1) as threads:
        future = threads.submit(session.run, tensors)
        try:
            future.result()
        except KeyboardInterrupt:
            print("run:", type(future.exception()).__name__, flush=True)
            raise

print("started", flush=True)
try:
    run() if {in_a_thread} else session.run(tensors)
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@pytest.mark.parametrize(
    ("kind", "signal_name", "in_a_thread"),
    [
        ("endless loop", "SIGINT", False),
        ("endless loop", "SIGTERM", True),
        ("long chain", "SIGTERM", False),
        ("long chain", "SIGHUP", False),
    ],
)
def test_a_signal_ends_a_run_that_would_take_minutes(kind, signal_name, in_a_thread):
    code = SIGNALLED_RUN.format(kind=kind, in_a_thread=in_a_thread)
    process = popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "started\n"
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(timeout=1)
    process.send_signal(getattr(signal, signal_name))
    out, err = process.communicate(timeout=LIMIT_S)
    assert out == ("run: KeyboardInterrupt\n" if in_a_thread else "") + "interrupted\n"
    assert err == ""
