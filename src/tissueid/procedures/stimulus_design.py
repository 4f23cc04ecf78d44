"""Trial of a feedback stimulus on a simulated tissue, which has no samples before its test."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test
from tissueid.acquisition.guided import check_test
from tissueid.acquisition.stimulus_choice import PRELOAD_S, check_new, save_stimulus, stimulus_from_file
from tissueid.acquisition.waveform_file import is_waveform
from tissueid.analysis.curves.feedback import FeedbackRun
from tissueid.analysis.stimulus_design import StimulusDesign
from tissueid.errors import LimitError, UnusableInputError
from tissueid.formatting import fixed, grouped
from tissueid.instrument import Limits, open_instrument
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.language import marked
from tissueid.messages import Verbatim
from tissueid.plan_options import Option, Plan, name_and_value, named_values
from tissueid.procedures.control import Control
from tissueid.procedures.depth_coverage import out_of_reach
from tissueid.procedures.output_files import check_different, check_output, write_text, writing
from tissueid.procedures.test_plan import design_stimulus, limits_of, saved_stimulus_options, specified
from tissueid.reports.stimulus_page import FORMS, feedback_report, feedback_run, output_suffix, stimulus_report
from tissueid.sessions import Test
from tissueid.stimuli import FeedbackKind, OpenLoopKind, Stimulus, get_stimulus, to_voltage
from tissueid.stimuli.stimulus_check import assess_stimulus
from tissueid.test_settings import FilePlayback, TestSettings

if TYPE_CHECKING:
    from tissueid.device import DeviceDescription
    from tissueid.stimuli import StimulusKind
    from tissueid.stimuli.interchange import InterchangeResult


_PLAYING = marked("Playing the stimulus")
_TISSUE = f"{IN_PROCESS}baseline?seed=0"
"""Simulated tissue on which a stimulus is tried by default."""


@dataclass(frozen=True)
class FeedbackTrial:
    """A feedback stimulus, the address of the tissue, the test, and its run with the report of the stimulus."""

    kind: FeedbackKind
    url: str
    test: Test
    run: FeedbackRun

    def rows(self) -> Iterator[tuple[str, str]]:
        """Yield the result as labels and values."""
        run, force, depth = self.run, self.run.force, self.run.depth
        yield "Length", f"{fixed(force.size / run.sample_rate_hz, 2)} s"
        yield "Range of force", f"{fixed(float(force.min()), 2)} to {fixed(float(force.max()), 2)} N"
        yield "Range of depth", f"{fixed(1e3 * float(depth.min()), 2)} to {fixed(1e3 * float(depth.max()), 2)} mm"
        yield (
            "Desired range of depth",
            f"{fixed(1e3 * float(run.edges[0]), 2)} to {fixed(1e3 * float(run.edges[-1]), 2)} mm",
        )
        if short := out_of_reach(self.test):
            yield "Reachable depth", short
        yield "Distance of depth from the desired distribution", fixed(run.distance, 3)
        yield "Computing time relative to test time", f"{fixed(100.0 * self.note('generating_share'), 1)} %"
        yield "Late blocks", grouped(self.note("late_blocks"))

    def note(self, name: str) -> float:
        """Return a number that the test noted; NaN if it did not."""
        return float(self.test.notes.get(name, float("nan")))


def try_on_tissue(kind: FeedbackKind, url: str | None, limits: Limits, control: Control) -> FeedbackTrial:
    """Run one test of a feedback stimulus on a simulated tissue; nothing is saved.

    Raises:
        UnusableInputError: a real instrument was named.
        LimitError: the stimulus could exceed the limits of the instrument, or did.
    """
    url = url or _TISSUE
    if not url.startswith(IN_PROCESS):
        raise UnusableInputError(
            "stimulus.feedback_on_instrument",
            "a feedback stimulus is designed on {tissue}; 'tissueid test --stimulus {kind}' plays it on an instrument",
            tissue=Verbatim(f"{IN_PROCESS}TISSUE"),
            kind=Verbatim(kind.name),
        )
    instrument = open_instrument(url)
    guided = GuidedTest(kind, TestSettings(site=url), limits=limits)
    try:
        check_test(guided, instrument.device)
        with tempfile.TemporaryDirectory() as folder:
            recorder = SessionRecorder(Path(folder) / "designed.h5", instrument.device)
            try:
                run_guided_test(
                    instrument, guided, recorder, progress=lambda step: control.progress(step.fraction, _PLAYING)
                )
            except BaseException:
                recorder.finish_or_discard()
                raise
            test = recorder.finish().tests[0]
    finally:
        instrument.close()
    return FeedbackTrial(kind, url, test, feedback_run(test, url.removeprefix(IN_PROCESS)))


CSV_HEAD = "time_s,"
"""First characters of a file of samples."""
_RANGES = (("min_force_n", "max_force_n"), ("min_volts", "max_volts"))
_FIELDS = {
    "force_min_n": "min_force_n",
    "force_max_n": "max_force_n",
    "voltage_min_v": "min_volts",
    "voltage_max_v": "max_volts",
    "seconds": "seconds",
    "seed": "seed",
}
"""Option of a stimulus: field of the plan."""


class StimulusPlan(FilePlayback, Plan):
    """A kind of stimulus with its options, or a saved stimulus; None to list all kinds.

    ``options`` are options of the kind without a field here. With ``list_options`` nothing is designed. ``device`` None
    is the desktop device, or for a feedback stimulus a simulated tissue.
    """

    what: Annotated[
        str | None,
        Option(
            argument=True,
            metavar="KIND|FILE",
            help="a kind, a saved stimulus or a waveform (.csv, .txt, .npy); default: list the kinds",
        ),
    ] = None
    options: Annotated[
        tuple[tuple[str, Any], ...],
        Option(
            "--option", metavar="NAME=VALUE", help="another option of the kind; may be repeated", read=name_and_value
        ),
    ] = ()
    list_options: Annotated[bool, Option("--options", help="list the options of the kind with their bounds")] = False
    min_force_n: Annotated[
        float | None, Option("--min-force", metavar="NEWTON", help="lower end of the force range")
    ] = None
    max_force_n: Annotated[
        float | None, Option("--max-force", metavar="NEWTON", help="upper end of the force range")
    ] = None
    min_volts: Annotated[
        float | None,
        Option("--min-volts", metavar="VOLT", help="lower end of the voltage range, in place of force"),
    ] = None
    max_volts: Annotated[
        float | None,
        Option("--max-volts", metavar="VOLT", help="upper end of the voltage range, in place of force"),
    ] = None
    seconds: Annotated[float | None, Option("--seconds", metavar="SECONDS", help="length without preload")] = None
    seed: Annotated[
        int | None, Option("--seed", help="seed; the same seed gives the same samples"), Field(ge=0, le=2**63 - 1)
    ] = None
    out: Annotated[Path | None, Option("--out", metavar="FILE", help="save the stimulus for 'tissueid test'")] = None
    csv: Annotated[Path | None, Option("--csv", metavar="FILE", help="write the samples as CSV")] = None
    plot: Annotated[
        Path | None, Option("--plot", metavar="FILE", help="write the figures as .html, .pdf, .png or .svg")
    ] = None
    device: Annotated[
        str | None,
        Option("--device", metavar="URL", help="instrument that plays it; default: the desktop device"),
    ] = None
    limits: Annotated[str, Option("--limits", help="clinical (12 N) or research (15 N)")] = "clinical"

    @property
    def outputs(self) -> tuple[Path | None, ...]:
        """Files that are named for output."""
        return self.out, self.csv, self.plot

    @property
    def lists(self) -> bool:
        """Whether kinds or options are listed, and nothing is designed."""
        return self.what is None or self.list_options

    @property
    def given(self) -> dict[str, tuple[str, float]]:
        """Name on the command line and value of the options that are given, by option of the stimulus."""
        return named_values(self, _FIELDS)

    @property
    def profile(self) -> Limits:
        """Limits that the stimulus must keep.

        Raises:
            UnusableInputError: there is no profile of that name.
        """
        return limits_of(self.limits)

    def check(self) -> None:
        """Check options and files before any work.

        Raises:
            UnusableInputError: the limits are unknown, an option has no stimulus, or a file cannot be written.
        """
        _ = self.profile
        if "-" in (str(self.csv), str(self.plot)):
            raise UnusableInputError(
                "stimulus.standard_output", "only JSON can go to standard output; name a file for samples and plots"
            )
        check_different(*self.outputs)
        check_output(self.csv, (CSV_HEAD,))
        if self.out is not None:
            check_new(self.out)
        if self.plot is not None:
            check_output(self.plot, FORMS[output_suffix(self.plot)])
        for option in () if self.from_file else self.file_options:
            raise UnusableInputError(
                "stimulus.file_options",
                "{option} is for a stimulus from a file: name the file",
                option=Verbatim(option),
            )
        if self.lists and (self.options or self.given or any(self.outputs)):
            raise UnusableInputError("stimulus.no_name", "name a stimulus; 'tissueid stimulus' lists all")

    @property
    def from_file(self) -> bool:
        """Whether the stimulus is in a file."""
        what = self.what or ""
        named = what.lower().endswith(".json") or "/" in what or is_waveform(Path(what)) or Path(what).is_file()
        return bool(what) and named

    def chosen(self, sample_rate_hz: float) -> Stimulus | StimulusKind:
        """Return the stimulus of the file, at the sample rate of the device, or the specification of a kind.

        Raises:
            UnusableInputError: the kind, the file or an option cannot be used.
        """
        what = self.what or ""
        if self.from_file:
            if self.options or self.given:
                raise saved_stimulus_options(Path(what))
            return stimulus_from_file(Path(what), sample_rate_hz, self)
        if all(any(getattr(self, field) is not None for field in ends) for ends in _RANGES):
            raise UnusableInputError("stimulus.two_ranges", "give the range either as force or as voltage")
        return specified(get_stimulus(what), list(self.options), self.given)


def run_stimulus(plan: StimulusPlan, control: Control) -> StimulusDesign | FeedbackTrial:
    """Design or read a stimulus, check it, and write the files of the plan.

    Returns:
        The stimulus with the figures of its check, or the trial of a feedback stimulus.

    Raises:
        UnusableInputError: the kind, an option, the device or a file cannot be used.
        LimitError: the instrument would refuse the stimulus.
        CancelledError: it was cancelled.
    """
    from tissueid.procedures.instruments import described_device

    plan.check()
    # Only a file needs the device first, for its sample rate; a feedback kind opens the instrument itself.
    device = described_device(plan.device) if plan.from_file else None
    chosen = plan.chosen(0.0 if device is None else device.sample_rate_hz)
    if isinstance(chosen, FeedbackKind):
        return _tried(plan, chosen, control)
    device = device or described_device(plan.device)
    search: InterchangeResult | None = None
    if isinstance(chosen, Stimulus):
        stimulus = chosen
    elif isinstance(chosen, OpenLoopKind):
        stimulus, search = design_stimulus(chosen, control)
    else:
        raise UnusableInputError(
            "stimulus.not_usable", "the stimulus '{name}' can be neither built nor generated", name=Verbatim(plan.what)
        )
    design = _checked(plan, stimulus, device, search)
    if plan.plot is not None:
        with writing(plan.plot):
            stimulus_report(design).write(plan.plot)
    if plan.csv is not None:
        write_text(plan.csv, _csv(design))
    _save(plan, stimulus)
    return design


def _checked(
    plan: StimulusPlan, stimulus: Stimulus, device: DeviceDescription, search: InterchangeResult | None
) -> StimulusDesign:
    limits = plan.profile
    appraisal = assess_stimulus(
        stimulus,
        device,
        max_force_n=limits.max_force_n,
        max_seconds=limits.max_seconds - (0.0 if stimulus.preload_s else PRELOAD_S),
        max_temperature_c=limits.max_temperature_c,
    )
    for concern in appraisal.concerns:
        if concern.severity == "refused":
            reason = concern.message.rstrip(".")
            raise LimitError(f"the instrument would refuse this stimulus: {reason[:1].lower()}{reason[1:]}")
    return StimulusDesign(stimulus, device, appraisal, search)


def _tried(plan: StimulusPlan, kind: FeedbackKind, control: Control) -> FeedbackTrial:
    if plan.csv is not None:
        raise UnusableInputError(
            "stimulus.no_samples",
            "the feedback stimulus {name} has no samples before its test: leave out --csv",
            name=Verbatim(kind.name),
        )
    trial = try_on_tissue(kind, plan.device, plan.profile, control)
    if plan.plot is not None:
        with writing(plan.plot):
            feedback_report(kind, [trial.run], tuple(trial.rows())).write(plan.plot)
    _save(plan, kind)
    return trial


def _save(plan: StimulusPlan, stimulus: Stimulus | FeedbackKind) -> None:
    if plan.out is not None:
        save_stimulus(plan.out, stimulus)


def _csv(design: StimulusDesign) -> str:
    """Return time, value and command of every sample as CSV, with numbers at full precision."""
    stimulus = design.stimulus
    command = to_voltage(stimulus.values, design.device, stimulus.unit)
    quantity = "force_n" if stimulus.unit == "N" else "voltage_v"
    text = io.StringIO()
    text.write(f"{CSV_HEAD}{quantity},command_v\n")
    time_s = np.arange(len(stimulus)) / stimulus.sample_rate_hz
    for row in zip(time_s.tolist(), stimulus.values.tolist(), command.tolist(), strict=True):
        text.write(f"{row[0]:.9g},{row[1]!r},{row[2]!r}\n")
    return text.getvalue()
