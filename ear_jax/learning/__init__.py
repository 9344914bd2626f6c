"""Learning: replay of outcomes, objectives and a learner per algorithm (SAC, PEARL, MAML)."""
