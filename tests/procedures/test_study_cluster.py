"""The same study on a Dask cluster: the same table, and a worker that is killed loses and doubles nothing."""

import os
import shutil
import signal
import socket
import subprocess
from pathlib import Path

import pandas as pd
import pytest
from coded import coded
from procedures.test_study import copy_sessions, folder, plan_of

from tissueid.errors import UnusableInputError
from tissueid.procedures import cluster as procedures_cluster
from tissueid.procedures.cluster import ClusterExecutor, plan_executor
from tissueid.procedures.control import Control
from tissueid.procedures.gap_plans import FolderPlan
from tissueid.procedures.identification import ComparePlan, run_comparison
from tissueid.procedures.study_plans import RESULTS
from tissueid.procedures.study_run import run_study

sessions = folder  # a fixture
dask, distributed = pytest.importorskip("dask"), pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore")  # those of the cluster's own threads and sockets


def cluster(workers, *, processes, protocol="tcp://", **options):
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=processes,
        protocol=protocol,
        host="127.0.0.1",
        dashboard_address=None,
        silence_logs=50,
        **options,
    )


def test_the_table_is_the_same(sessions, tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    copy_sessions(sessions, here, subjects=1)
    copy_sessions(sessions, there, subjects=1)
    known = run_study(plan_of(here), Control())
    with cluster(1, processes=False) as running:
        found = run_study(plan_of(there, scheduler=running.scheduler_address), Control())
    pd.testing.assert_frame_equal(found.table, known.table)


def test_engines_of_a_comparison_are_fitted_on_the_cluster(sessions, tmp_path):
    copy_sessions(sessions, tmp_path, subjects=1)
    plan = ComparePlan(session=tmp_path / "P0-arm.h5", engines=("lms", "hammerstein"))
    here = run_comparison(plan, Control()).comparison
    with cluster(1, processes=False) as running:
        there = run_comparison(plan.model_copy(update={"scheduler": running.scheduler_address}), Control()).comparison
    assert there.recommendation == here.recommendation
    assert list(there.analyses) == list(here.analyses)


@pytest.mark.soak
def test_a_worker_that_is_killed_loses_and_doubles_nothing(sessions, tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    copy_sessions(sessions, here)
    copy_sessions(sessions, there)
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


def test_a_cluster_that_finishes_nothing_is_left_after_a_time(sessions, tmp_path):
    copy_sessions(sessions, tmp_path / "s", subjects=1)
    with cluster(0, processes=False) as running:
        plan = plan_of(tmp_path / "s", scheduler=running.scheduler_address, cluster_timeout_s=0.3)
        with pytest.raises(UnusableInputError, check=coded("cluster.stopped")):
            run_study(plan, Control())
    assert not list((tmp_path / "s" / RESULTS).glob("table.*"))


@pytest.mark.soak
def test_a_worker_that_dies_again_and_again_is_one_line():
    with cluster(1, processes=True) as running, distributed.Client(running) as client:
        executor = ClusterExecutor(client, 60.0)
        with (
            pytest.raises(UnusableInputError, check=coded("cluster.stopped")),
            dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        ):
            executor.do(os._exit, [1], lambda: False, lambda _: None)


@pytest.mark.parametrize(
    ("values", "code"),
    [
        ({"scheduler": "tcp://192.0.2.1:8786"}, "cluster.plain"),
        ({"scheduler": "192.0.2.1:8786"}, "cluster.plain"),
        ({"scheduler": "tcp://127.0.0.1:80@192.0.2.1:8786"}, "cluster.plain"),
        ({"scheduler": "ws://192.0.2.1:8786"}, "cluster.plain"),
        ({"scheduler": "tls://192.0.2.1:8786"}, "cluster.certificates"),
        ({"scheduler": "tls://127.0.0.1:9", "tls_ca": Path("a"), "tls_cert": Path("b")}, "cluster.no_scheduler"),
        ({"scheduler": "tcp://127.0.0.1:9", "plain_tcp": True}, "cluster.no_scheduler"),
        ({"scheduler": "none://x"}, "cluster.plain"),
        ({"scheduler": "none://localhost"}, "cluster.no_scheduler"),
    ],
)
def test_addresses_that_are_refused(tmp_path, monkeypatch, values, code):
    monkeypatch.setattr(procedures_cluster, "CONNECT_TIMEOUT_S", 0.2)
    plan = FolderPlan(folder=tmp_path, **values)
    with pytest.raises(UnusableInputError, check=coded(code)), plan_executor(None, plan):
        pass


def test_a_scheduler_that_takes_the_connection_and_is_silent_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(procedures_cluster, "CONNECT_TIMEOUT_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        plan = FolderPlan(folder=tmp_path, scheduler=f"tcp://127.0.0.1:{server.getsockname()[1]}")
        with pytest.raises(UnusableInputError, check=coded("cluster.no_scheduler")), plan_executor(None, plan):
            pass


@pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl to make certificates")
def test_a_scheduler_is_reached_by_tls_with_certificates_of_one_authority(tmp_path):
    for name in ("own", "other"):
        key, certificate = tmp_path / f"{name}.key", tmp_path / f"{name}.pem"
        curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2")
        words = ["openssl", "req", "-x509", *curve, "-subj", f"/CN={name}", "-keyout", key, "-out", certificate]
        subprocess.run(words, check=True, capture_output=True)
    own, key = str(tmp_path / "own.pem"), str(tmp_path / "own.key")
    sides = {
        f"tls_{side}_{part}": path
        for side in ("scheduler", "worker", "client")
        for part, path in (("cert", own), ("key", key))
    }
    security = distributed.security.Security(require_encryption=True, tls_ca_file=own, **sides)
    with cluster(1, processes=False, protocol="tls://", security=security) as running:
        files = {"scheduler": running.scheduler_address, "tls_cert": own, "tls_key": key}
        plan = FolderPlan(folder=tmp_path, tls_ca=own, **files)
        with plan_executor(None, plan) as executor:
            assert executor.do(abs, [-1], lambda: False, lambda _: None) == [1]
        other = plan.model_copy(update={"tls_ca": tmp_path / "other.pem"})
        with pytest.raises(UnusableInputError, check=coded("cluster.no_scheduler")), plan_executor(None, other):
            pass


def test_no_scheduler_is_one_line(sessions, tmp_path, monkeypatch):
    copy_sessions(sessions, tmp_path / "s", subjects=1)
    monkeypatch.setattr(procedures_cluster, "CONNECT_TIMEOUT_S", 0.2)
    with pytest.raises(UnusableInputError) as caught:
        run_study(plan_of(tmp_path / "s", scheduler="tcp://127.0.0.1:9"), Control())
    assert caught.value.message.code == "cluster.no_scheduler"
