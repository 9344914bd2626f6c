"""The paper's tables and figures, and the runs behind them; used from the checkout, as `python -m experiments`."""
