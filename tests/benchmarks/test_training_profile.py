# ruff: noqa: D103 (a test's name says what it shows)
"""Where the time of an update goes, from a made-up trace."""

from __future__ import annotations

import json

import pytest

from benchmarks import speed_tables
from benchmarks import training_profile as profile
from benchmarks.training_profile import Kernel

PROGRAM = """
  %loop_add.3 = f32[8]{0} add(%a, %b), metadata={op_name="jit(run)/while/body/learn/add" stack_frame_id=3}
  ROOT %fused-sum = f32[] reduce(%c), metadata={op_name="jit(run)/while/body/env_step/vmap()/sum"}
  %bare = f32[] add(%a, %b)
"""


def test_kernels_are_known_by_the_names_of_the_programs_instructions():
    assert profile.scopes(PROGRAM) == {
        "loop_add_3": "jit(run)/while/body/learn/add",
        "fused_sum": "jit(run)/while/body/env_step/vmap()/sum",
    }


@pytest.mark.parametrize(
    ("name", "scope", "part"),
    [
        ("_kinematics_branch_95f8028e_cuda_kernel_forward", "", "rigid bodies"),
        ("memtile_value_kernel<int>", "jit(run)/env_step/step/ffi_call", "rigid bodies"),
        ("batched_cloth", "", "matter"),
        ("particles", "", "matter"),
        ("loop_add_3", "", "learning"),
        ("fused-sum", "", "rest of the step"),
        ("sm80_gemm", "jit(run)/while/body/act/dot_general", "acting"),
        ("sm80_gemm", "", None),
        ("loop_fusion", "jit(run)/while/body/learned", None),  # a scope is a whole word
    ],
)
def test_each_kernel_belongs_to_a_part(name, scope, part):
    assert profile.part_of(Kernel(name, 0, 1, scope), profile.scopes(PROGRAM)) == part


def test_a_kernel_without_a_scope_counts_as_most_of_those_launched_with_it():
    kernels = [
        Kernel("gemm", 0, 30, group="buffer_1"),
        Kernel("loop_add_3", 30, 8, group="buffer_1"),
        Kernel("fused_sum", 40, 5, group="buffer_1"),
        Kernel("gemm", 50, 99, group="buffer_2"),  # hardly anything of its group is known
        Kernel("loop_add_3", 150, 1, group="buffer_2"),
        Kernel("copy", 160, 5),
        Kernel("loop_add_3", 170, 5),  # without a group, neighbours say nothing
    ]
    parts = profile.parts_of(kernels, profile.scopes(PROGRAM))
    assert parts == [
        "learning", "learning", "rest of the step", "other", "learning", "other", "learning",
    ]  # fmt: skip


def test_shares_and_idle_time_add_up_to_one_where_kernels_overlap():
    kernels = [
        Kernel("loop_add_3", 0, 40),
        Kernel("fused_sum", 20, 40),  # 20 of them beside the first
        Kernel("fused_sum", 80, 20),
    ]
    found = profile.summary(kernels, profile.scopes(PROGRAM))
    assert profile.busy(kernels) == 80
    assert found["share/idle"] == pytest.approx(0.2)
    assert found["share/learning"] == pytest.approx(0.8 * 0.4)
    assert found["share/rest of the step"] == pytest.approx(0.8 * 0.6)
    assert sum(v for k, v in found.items() if k.startswith("share/")) == pytest.approx(1)
    assert found["kernels"] == 3 and found["seconds"] == 0.0
    assert found["largest"][0] == ["fused_sum", "rest of the step", 0.48, 2]


def test_the_table_says_how_much_would_be_idle_without_the_trace(tmp_path):
    line = {
        "env": "A-v0", "impl": "warp", "num_envs": 8, "num_seeds": 2, "steps": 1000, "steps_per_s": 2000,
        "seconds": 0.6, "commit": "0123456789", "device": {"kind": "GPU"}, "share/idle": 0.25,
        "largest": [["_solve__locals__kernel", "rigid bodies", 0.4, 9]],
    } | {f"share/{part}": 0.125 for part in profile.PARTS}  # fmt: skip
    (tmp_path / "training_profile.jsonl").write_text(json.dumps(line))
    (row,) = speed_tables.profile(tmp_path).splitlines()[2:3]
    assert "25% (10%)" in row  # 0.45 s busy of the 0.5 s that the update takes otherwise
    assert row.endswith("| `_solve`, 40% |")


def test_without_a_gpu_it_says_so(capsys):
    assert profile.main(["--env-name", "ReachingJaco-v0"]) == 2
    assert "needs an NVIDIA GPU" in capsys.readouterr().err
