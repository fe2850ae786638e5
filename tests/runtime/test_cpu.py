"""The description of the CPU, from copies of /proc/cpuinfo."""

import os

from duospacenet.runtime import cpu

CPUINFO = """processor\t: 0
model name\t: Some CPU @ 2.00GHz
flags\t\t: fpu avx2 avx512f amx_tile avx512_vnni

processor\t: 1
model name\t: Another CPU
flags\t\t: fpu
"""


def write_cpuinfo(root, text):
    (root / "proc").mkdir()
    (root / "proc" / "cpuinfo").write_text(text)
    return root


def test_model_and_instruction_sets_are_those_of_the_first_core(tmp_path):
    found = cpu.read_cpu(write_cpuinfo(tmp_path, CPUINFO))
    assert found.model == "Some CPU @ 2.00GHz"
    assert found.instruction_sets == ("avx2", "avx512f", "avx512_vnni", "amx_tile")
    assert set(found.affinity) == os.sched_getaffinity(0)


def test_control_characters_of_the_model_name_are_escaped(tmp_path):
    found = cpu.read_cpu(write_cpuinfo(tmp_path, "model name : A\x1b[2JB\nflags : avx2\n"))
    assert found.model == "A\\x1b[2JB"


def test_a_system_without_cpuinfo_has_a_model_and_no_instruction_sets(tmp_path):
    found = cpu.read_cpu(tmp_path)
    assert found.model
    assert found.instruction_sets == ()
    assert found.cores >= 1


def test_the_description_is_one_line_with_cores_and_instruction_sets():
    text = cpu.describe_cpu()
    assert "\n" not in text
    assert f"{cpu.read_cpu().cores} cores" in text
