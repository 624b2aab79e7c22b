"""``pharos evaluate``: accuracy on public data sets, and what papers claim, repeated."""

import typer

from app.cli.evaluate_growth import evaluate_growth
from app.cli.evaluate_maps import evaluate_ageing, evaluate_survey_report
from app.cli.evaluate_ms2020 import evaluate_ms2020
from app.cli.evaluate_papers import evaluate_papers
from app.cli.evaluate_report import write_report
from app.cli.evaluate_survey_walks import evaluate_survey_walks
from app.cli.evaluate_tables import (
    evaluate_kolakowski,
    evaluate_oxford_steps,
    evaluate_uji_ble,
    evaluate_ujiindoorloc,
)

evaluating = typer.Typer(
    no_args_is_help=True, help="Measure accuracy, on public data sets and as the papers do."
)
evaluating.command("report")(write_report)
evaluating.command("ms2020")(evaluate_ms2020)
evaluating.command("survey-report")(evaluate_survey_report)
evaluating.command("ageing")(evaluate_ageing)
evaluating.command("growth")(evaluate_growth)
evaluating.command("uji-ble")(evaluate_uji_ble)
evaluating.command("kolakowski")(evaluate_kolakowski)
evaluating.command("ujiindoorloc")(evaluate_ujiindoorloc)
evaluating.command("oxford-steps")(evaluate_oxford_steps)
evaluating.command("survey-walks")(evaluate_survey_walks)
evaluating.command("papers")(evaluate_papers)
