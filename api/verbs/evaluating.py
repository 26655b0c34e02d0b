"""Verb ``evaluate``: chart models against each other on lights held out."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from acquisition.dataset import staged_file
from acquisition.importing import load_any
from reconstruct.evaluate import Evaluation
from reconstruct.evaluate import evaluate as judge
from reconstruct.model import Progress, no_progress


def evaluate(
    dataset: Path,
    models: Sequence[str],
    *,
    test: Path | None = None,
    holdout: str | None = None,
    report: Path | None = None,
    progress: Progress = no_progress,
) -> Evaluation:
    """Fit `models` to some images of `dataset`, judge them on the others and, where asked, write a page with pictures.

    Parameters
    ----------
    dataset, test : Path
        Any folder that ``import`` reads; `test` is a set of its own to judge on.
    models : sequence of str
        Registered names.
    holdout : str, optional
        See `reconstruct.holdout.hold_out`; ``every:5`` where neither this nor `test` is given.
    report : Path, optional
        HTML file to write.

    Returns
    -------
    Evaluation
        Its ``rows`` are the table.
    """
    data = load_any(dataset)
    tested = load_any(test) if test is not None else None
    with ExitStack() as stack:
        if report is None:
            return judge(data, models, holdout=holdout, test=tested, progress=progress)
        # The place is checked before the work begins.
        page = stack.enter_context(staged_file(report))
        from api.evaluation_report import Inspector, evaluation_content
        from api.report import write_report

        inspector = Inspector(tested or data)
        evaluation = judge(data, models, holdout=holdout, test=tested, progress=progress, inspect=inspector)
        write_report(page, evaluation_content(evaluation, data, tested or data))
        return evaluation
