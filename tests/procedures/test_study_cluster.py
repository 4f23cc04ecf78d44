"""The same study on a Dask cluster: the same table, and a worker that is killed loses and doubles nothing."""

import os
import signal

import pandas as pd
import pytest
from procedures.test_study import fill, plan_of

from tissueid.errors import UnusableInputError
from tissueid.procedures.comparison import ComparePlan, run_comparison
from tissueid.procedures.control import Control
from tissueid.procedures.study_plans import RESULTS
from tissueid.procedures.study_run import run_study

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore")  # those of the cluster's own threads and sockets


def cluster(workers, *, processes):
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=processes,
        protocol="tcp://",
        host="127.0.0.1",
        dashboard_address=None,
        silence_logs=50,
    )


def test_the_table_is_the_same(tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    fill(here, subjects=1)
    fill(there, subjects=1)
    known = run_study(plan_of(here), Control())
    with cluster(1, processes=False) as running:
        found = run_study(plan_of(there, scheduler=running.scheduler_address), Control())
    pd.testing.assert_frame_equal(found.table, known.table)


def test_engines_of_a_comparison_are_fitted_on_the_cluster(tmp_path):
    fill(tmp_path, subjects=1)
    plan = ComparePlan(session=tmp_path / "P0-arm.h5", engines=("lms", "hammerstein"))
    here = run_comparison(plan, Control()).found
    with cluster(1, processes=False) as running:
        there = run_comparison(plan.model_copy(update={"scheduler": running.scheduler_address}), Control()).found
    assert there.recommendation == here.recommendation
    assert list(there.analyses) == list(here.analyses)


@pytest.mark.soak
def test_a_worker_that_is_killed_loses_and_doubles_nothing(tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    fill(here)
    fill(there)
    known = run_study(plan_of(here), Control())
    with cluster(2, processes=True) as running:
        victims = [worker.pid for worker in running.workers.values()][:1]

        class Killing(Control):
            def progress(self, fraction, step):
                if victims and fraction and fraction > 0.2:
                    os.kill(victims.pop(), signal.SIGKILL)

        found = run_study(plan_of(there, scheduler=running.scheduler_address), Killing())
    assert not victims
    pd.testing.assert_frame_equal(found.table, known.table)
    assert len(list((there / RESULTS).glob("lms-*/*.json"))) == found.sessions
    assert run_study(plan_of(there), Control()).analysed == 0


def test_no_scheduler_is_one_line(tmp_path, monkeypatch):
    fill(tmp_path / "s", subjects=1)
    monkeypatch.setattr("tissueid.procedures.cluster.CONNECT_TIMEOUT_S", 0.2)
    with pytest.raises(UnusableInputError) as caught:
        run_study(plan_of(tmp_path / "s", scheduler="tcp://127.0.0.1:9"), Control())
    assert caught.value.message.code == "cluster.no_scheduler"
