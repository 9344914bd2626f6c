"""Emergent action representations: one policy for many tasks, trained end to end in JAX on MuJoCo.

    from ear_jax.presets import preset_config
    from ear_jax.run import train_run

    train_run(preset_config("halfcheetah-vel", "fast"), Path("runs/mine"))

`docs/architecture.md` says what is in which file; the `ear` command is the same functions from a shell.
"""

__version__ = "0.1.0"
