"""Speed against accuracy: what each method costs for its accuracy, one chart for each question that users ask."""

from importlib import import_module

from tqdm import tqdm

from .accuracy import save_chart
from .rows import Outcome

QUESTIONS = ('accuracy_bands', 'accuracy_transient', 'accuracy_frf', 'accuracy_nonlinear')


def main(out, quick=False):
    """One chart for each of the QUESTIONS, each from the module of its name; `quick` takes smaller systems and fewer repeats."""
    checks, pictures = [], []
    for question in tqdm(QUESTIONS, desc='charts', leave=False, disable=None):
        chart = import_module(f'.{question}', __package__).chart(quick)
        checks += chart.checks
        pictures.append(save_chart(chart, out, question))
    return Outcome(checks, pictures)
