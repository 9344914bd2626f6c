"""How agents learn: replay of outcomes, the objectives, and one learner for each kind of algorithm."""
