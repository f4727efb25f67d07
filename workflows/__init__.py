"""The paper's results, one file per figure or claim; `python -m workflows` runs them and compares each with its reference."""
