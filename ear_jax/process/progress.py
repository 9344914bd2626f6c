"""A count of the environment steps that the native engine took, by which long roll-outs show that they go on."""

from __future__ import annotations


class StepCount:
    """Environment steps since the process began, of all simulations together."""

    def __init__(self) -> None:
        self.taken = 0

    def add(self, steps: int) -> None:
        """Counts steps; called on the host, by one thread at a time."""
        self.taken += steps


env_steps = StepCount()
