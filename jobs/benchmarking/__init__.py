"""The benchmark of a bundle: its speed and memory, beside alternatives that run in the same minutes.

Start reading in `bench_job.py`. Everything that is measured runs in a separate process: `worker.py` is the process,
`worker_process.py` starts it. `runners.py` and `stateless_runners.py` run one frame of each kind of target.
"""
