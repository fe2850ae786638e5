import os

import pytest

from duospacenet.runtime.cores import available_cores

# The content of /proc/self/cgroup, the files below /sys/fs/cgroup, and the expected cores on a machine with 8 cores.
CASES = {
    "no group": ("", {}, 8),
    "version 2, quota of the process's own group": ("0::/a/b\n", {"a/b/cpu.max": "150000 100000"}, 2),
    "version 2, quota of the parent group": (
        "0::/a/b\n",
        {"a/cpu.max": "50000 100000", "a/b/cpu.max": "max 100000"},
        1,
    ),
    "version 2, the smallest quota counts": (
        "0::/a/b\n",
        {"a/cpu.max": "700000 100000", "a/b/cpu.max": "300000 100000"},
        3,
    ),
    "version 2, in a container": ("0::/\n", {"cpu.max": "250000 100000"}, 3),
    "version 2, no quota": ("0::/a\n", {"a/cpu.max": "max 100000"}, 8),
    "version 1": (
        "4:memory:/x\n3:cpu,cpuacct:/a\n",
        {"cpu,cpuacct/a/cpu.cfs_quota_us": "400000", "cpu,cpuacct/a/cpu.cfs_period_us": "100000"},
        4,
    ),
    "version 1, no quota": (
        "3:cpu:/a\n",
        {"cpu/a/cpu.cfs_quota_us": "-1", "cpu/a/cpu.cfs_period_us": "100000"},
        8,
    ),
    "quota of an unrelated group": ("0::/a\n", {"b/cpu.max": "100000 100000"}, 8),
    "file above the hierarchy": ("0::/a\n", {"../cpu.max": "100000 100000"}, 8),
    "quota of 0": ("0::/a\n", {"a/cpu.max": "0 100000"}, 8),
    "invalid quota": ("0::/a\n", {"a/cpu.max": "many"}, 8),
}


@pytest.mark.parametrize("case", CASES)
def test_the_quota_of_the_control_groups_limits_the_cores(tmp_path, monkeypatch, case):
    groups, files, cores = CASES[case]
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text(groups)
    for name, content in files.items():
        (tmp_path / "sys/fs/cgroup" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "sys/fs/cgroup" / name).write_text(content + "\n")
    assert available_cores(tmp_path) == cores


def test_without_control_groups_the_affinity_limits_the_cores(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 3}, raising=False)
    assert available_cores(tmp_path) == 2


def test_without_an_affinity_the_number_of_cores_of_the_machine_counts_or_else_one(tmp_path, monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    for count, cores in ((6, 6), (None, 1)):
        monkeypatch.setattr(os, "cpu_count", lambda count=count: count)
        assert available_cores(tmp_path) == cores
