"""SBX's SAC on Gymnasium's HalfCheetah; `benchmarks.peers` runs it in a virtual environment of its own.

    python peer_sbx.py SETTINGS

SETTINGS is a JSON object: `envs`, `width`, `layers`, `batch_size`, and `steps` to time, each with one update. Prints
env steps per second, collection and updates together.
"""

from __future__ import annotations

import importlib.metadata
import json
import sys
import time

from sbx import SAC
from stable_baselines3.common.env_util import make_vec_env


def main() -> None:
    s = json.loads(sys.argv[1])
    model = SAC(
        "MlpPolicy",
        make_vec_env("HalfCheetah-v5", n_envs=s["envs"], seed=0),
        batch_size=s["batch_size"],
        train_freq=1,
        gradient_steps=s["envs"],
        learning_starts=s["batch_size"],
        policy_kwargs={"net_arch": [s["width"]] * s["layers"]},
        seed=0,
    )
    model.learn(4 * s["batch_size"])  # compiles
    began = time.perf_counter()
    model.learn(s["steps"], reset_num_timesteps=False)
    seconds = time.perf_counter() - began
    print(json.dumps({"steps_per_second": s["steps"] / seconds, "version": importlib.metadata.version("sbx-rl")}))


if __name__ == "__main__":
    main()
