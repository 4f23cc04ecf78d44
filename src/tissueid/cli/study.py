"""``tissueid study``: statistics over the sessions of a folder."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from tissueid.cli.lazy_command import JsonFile, add_command

if TYPE_CHECKING:  # plans are imported when their command is used
    from tissueid.procedures.study_demo import PopulationPlan
    from tissueid.procedures.study_plans import StudyPlan, StudyReportPlan
    from tissueid.procedures.study_sitting import ProtocolPlan, SittingRunPlan

study = typer.Typer(help="Compare subjects, sites and conditions over many sessions.", no_args_is_help=True)


@add_command(study, "run", "study_plans")
def run_command(plan: StudyPlan, json_file: JsonFile = None) -> None:
    """Analyse the sessions of a study that have changed.

    Writes the table with one row per test as CSV and Parquet. After a kill the same command continues.
    """
    from tissueid.cli.study_output import print_run

    print_run(plan, json_file)


@add_command(study, "table", "study_plans")
def table_command(plan: StudyPlan, json_file: JsonFile = None) -> None:
    """Show mean, standard deviation and variation of each parameter by site and condition.

    Analyses what has changed before.
    """
    from tissueid.cli.study_output import print_table

    print_table(plan, json_file)


@add_command(study, "report", "study_plans")
def report_command(plan: StudyReportPlan, json_file: JsonFile = None) -> None:
    """Write the report of a study as an HTML page.

    Repeatability, sites, groups, regressions, conditions and sample sizes.
    """
    from tissueid.cli.study_output import print_report

    print_report(plan, json_file)


@add_command(study, "demo", "study_demo")
def demo_command(plan: PopulationPlan, json_file: JsonFile = None) -> None:
    """Measure a simulated population, analyse it and write its report.

    16 subjects, 4 sites and 5 repeats by default, as in the thesis.
    """
    from tissueid.cli.study_output import print_population

    print_population(plan, json_file)


@add_command(study, "protocol", "study_sitting")
def protocol_command(plan: ProtocolPlan, json_file: JsonFile = None) -> None:
    """Check the protocol of a study, or write a template of one.

    Sites, repeats, conditions, demographic values that are asked for, and the order of a sitting.
    """
    from tissueid.cli.sitting_output import print_protocol

    print_protocol(plan, json_file)


@add_command(study, "sitting", "study_sitting")
def sitting_command(plan: SittingRunPlan, json_file: JsonFile = None) -> None:
    """Run all tests of one subject by the protocol, on the simulator.

    The same command continues a sitting that was interrupted; complete tests are kept.
    """
    from tissueid.cli.sitting_output import print_sitting

    print_sitting(plan, json_file)
