"""The report: the paper's tables and figures beside ours, from the committed records alone. Trains nothing."""
