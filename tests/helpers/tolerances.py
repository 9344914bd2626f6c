"""Measured errors of MJX against C MuJoCo."""

from __future__ import annotations

MJX_TOLERANCES = {  # errors of qpos and of qvel: median, 99th percentile, worst; about 4 times what was measured
    "halfcheetah-vel": ((5e-7, 1e-5, 1.2e-4), (2e-5, 8e-4, 1.5e-2)),  # 1.2e-7, 2.4e-6, 2.8e-5; 4.4e-6, 1.8e-4, 3.7e-3
    "ant-dir": ((5e-7, 5e-2, 1.2e-1), (6e-6, 4.0, 7.0)),  # 1.2e-7, 1.1e-2, 2.9e-2; 1.3e-6, 8.5e-1, 1.6
    "hopper-vel": ((3e-7, 1e-6, 3e-5), (2e-6, 4e-5, 6e-3)),  # 6.0e-8, 2.4e-7, 6.4e-6; 4.8e-7, 7.9e-6, 1.4e-3
    "walker-vel": ((5e-7, 2e-6, 6e-6), (4e-5, 4e-4, 1e-3)),  # 1.2e-7, 4.8e-7, 1.3e-6; 7.6e-6, 9.0e-5, 2.2e-4
    "halfcheetah-run-jump": ((5e-7, 1e-5, 1.2e-4), (2e-5, 8e-4, 1.5e-2)),
}
