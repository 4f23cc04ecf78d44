"""Stimulus of a test as selected on the command line or in the window, and files of designed stimuli."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.acquisition.waveform_file import is_waveform, load_waveform, read_at_most
from tissueid.atomic_write import atomic_file
from tissueid.errors import UnusableInputError
from tissueid.messages import Message
from tissueid.stimuli import build_from_specification
from tissueid.stimuli.base import (
    GUIDED,
    FeedbackKind,
    OpenLoopKind,
    Stimulus,
    StimulusKind,
    parse_description,
    with_preload,
)
from tissueid.stimuli.kinds.noise import Noise
from tissueid.stimuli.kinds.waveform import Scaled, Waveform
from tissueid.test_settings import USUAL_FORCE_N, USUAL_SECONDS, USUAL_SEED, FilePlayback
from tissueid.untrusted_input import json_value
from tissueid.version import SOFTWARE

FORMAT = "tissueid-stimulus"
FORMAT_VERSION = "1.0"
_MAX_BYTES = 4 * 1024 * 1024
"""Maximum size of a stimulus file, bytes."""


def save_stimulus(path: Path, stimulus: Stimulus | FeedbackKind) -> None:
    """Write a stimulus to a new file atomically.

    Raises:
        UnusableInputError: the file exists, the folder is missing, the file cannot be written, or the stimulus is a
            waveform, whose samples a saved stimulus does not hold.
    """
    check_new(path)
    if isinstance(stimulus, Stimulus) and isinstance(parse_description(stimulus.description)[0], Waveform):
        raise UnusableInputError(
            "stimulus.waveform_saved",
            "a saved stimulus holds no samples, so that a waveform cannot be saved as one: keep its own file",
        )
    text = json.dumps(_content(stimulus), indent=2, allow_nan=False) + "\n"
    try:
        with atomic_file(path, new=True, shared=True) as partial:
            partial.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UnusableInputError(
            "file.not_writable", "cannot write {path}: {reason}", path=str(path), reason=str(error.strerror)
        ) from error


def check_new(path: Path) -> None:
    """Check that a stimulus can be saved to a file.

    Raises:
        UnusableInputError: the file exists, or its folder does not.
    """
    if path.is_dir():
        raise UnusableInputError("file.is_folder", "{path} is a folder; name a file", path=str(path))
    if path.exists():
        raise UnusableInputError(
            "stimulus.exists", "{path} exists already; a saved stimulus is never overwritten", path=str(path)
        )
    if not path.parent.is_dir():
        raise UnusableInputError("file.no_folder", "there is no folder {folder}", folder=str(path.parent))


def load_stimulus(path: Path) -> Stimulus | FeedbackKind:
    """Read a stimulus: rebuilt and verified, or the specification of a feedback stimulus.

    Raises:
        UnusableInputError: no such file, not a stimulus, too large, or built differently by this version.
    """
    content = _read(path)
    description = content.get("description")
    if not isinstance(description, dict):
        raise UnusableInputError("stimulus.no_description", "{path} holds no description of a stimulus", path=str(path))
    specification, preload_s = parse_description(description)
    if isinstance(specification, FeedbackKind):
        if preload_s is not None:
            raise UnusableInputError(
                "stimulus.own_preload",
                "{path}: '{name}' takes its preload from the test, not from a file",
                path=str(path),
                name=specification.name,
            )
        return specification
    built = build_from_specification(specification, preload_s)
    _verify(path, content, built)
    return built


def checksum(stimulus: Stimulus) -> str:
    """Return the SHA-256, hexadecimal, of the values as little-endian float64."""
    return hashlib.sha256(np.ascontiguousarray(stimulus.values, dtype="<f8").tobytes()).hexdigest()


def _content(stimulus: Stimulus | FeedbackKind) -> dict[str, Any]:
    head = {"format": FORMAT, "format_version": FORMAT_VERSION, "software": SOFTWARE}
    if isinstance(stimulus, FeedbackKind):
        return head | {
            "description": stimulus.describe(),
            "samples": None,
            "sample_rate_hz": stimulus.sample_rate,
            "unit": "N",
            "sha256": None,
        }
    return head | {
        "description": stimulus.description,
        "samples": len(stimulus),
        "sample_rate_hz": stimulus.sample_rate_hz,
        "unit": stimulus.unit,
        "sha256": checksum(stimulus),
    }


def _read(path: Path) -> dict[str, Any]:
    """Return the JSON object in a stimulus file.

    Raises:
        UnusableInputError: it cannot be read, is too large, or is no stimulus file.
    """
    data = read_at_most(
        path,
        _MAX_BYTES,
        Message(
            "stimulus.too_large",
            "{path} is larger than {most} MB: it is not a saved stimulus",
            path=str(path),
            most=_MAX_BYTES >> 20,
        ),
    )
    try:
        content = json_value(data)
    except ValueError as error:
        raise UnusableInputError(
            "stimulus.damaged", "{path} is damaged, or not a saved stimulus", path=str(path)
        ) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise UnusableInputError("stimulus.not_one", "{path} is not a saved stimulus", path=str(path))
    version = content.get("format_version")
    if not isinstance(version, str) or version.split(".")[0] != FORMAT_VERSION.split(".")[0]:
        raise UnusableInputError(
            "stimulus.version",
            "{path} has format version '{version}', but this software reads {known}: install a newer TissueID",
            path=str(path),
            version=str(version)[:20],
            known=FORMAT_VERSION,
        )
    return content


def _verify(path: Path, content: Mapping[str, Any], built: Stimulus) -> None:
    """Compare the rebuilt stimulus with the stored properties.

    Raises:
        UnusableInputError: length, sample rate, unit or samples differ.
    """
    saved = (content.get("samples"), content.get("sample_rate_hz"), content.get("unit"))
    if saved != (len(built), built.sample_rate_hz, built.unit):
        raise UnusableInputError(
            "stimulus.figures", "{path}: length, rate or unit contradict its description", path=str(path)
        )
    if content.get("sha256") != checksum(built):
        by = str(content.get("software", "another version"))[:40]
        raise UnusableInputError(
            "stimulus.differs",
            "{path}: the stimulus built from the description differs from the one that {software} saved: another "
            "version or another processor computes it differently; design the stimulus again",
            path=str(path),
            software=by,
        )


_AS_IT_IS = FilePlayback()
FIXTURES = ("spring", "free_air")
"""Kinds of test in which the probe is not on tissue, as stored in a session."""
PRELOAD_S = 0.5
"""Default length of the preload, s, in which the tissue settles at the mean load (thesis 7.1.1)."""


def usual_noise(sample_rate_hz: float, **options: Any) -> Stimulus:
    """Return noise with its preload; without ``options`` of the kind it is the usual one.

    Raises:
        UnusableInputError: an option is not valid.
    """
    return with_preload(Noise.from_options(usual_options(sample_rate_hz) | options).build(), PRELOAD_S)


def usual_options(sample_rate_hz: float) -> dict[str, Any]:
    """Return the options of the usual noise, SI."""
    low_n, high_n = USUAL_FORCE_N
    force = {"force_min_n": low_n, "force_max_n": high_n}
    return force | {"seconds": USUAL_SECONDS, "seed": USUAL_SEED, "sample_rate": sample_rate_hz}


def playable(
    specification: StimulusKind, build: Callable[[OpenLoopKind], Stimulus] = lambda kind: kind.build()
) -> Stimulus | FeedbackKind:
    """Return the stimulus of a specification with its preload, or the specification itself if it needs feedback.

    Raises:
        UnusableInputError: it is too large, or can neither be built nor generated during a test.
    """
    if isinstance(specification, FeedbackKind):
        return specification
    if not isinstance(specification, OpenLoopKind):
        raise UnusableInputError(
            "stimulus.not_playable", "the stimulus '{name}' cannot be played", name=specification.name
        )
    specification.check_size()
    return with_preload(build(specification), PRELOAD_S)


def stimulus_from_file(path: Path, sample_rate_hz: float, played: FilePlayback = _AS_IT_IS) -> Stimulus | FeedbackKind:
    """Return the waveform or the saved stimulus, without a preload that it does not have itself.

    Raises:
        UnusableInputError: the file cannot be read or holds no stimulus, or it cannot be played so.
    """
    scale, offset = 1.0 if played.scale is None else played.scale, 0.0 if played.offset is None else played.offset
    if is_waveform(path):
        return load_waveform(path, sample_rate_hz, file_rate_hz=played.file_rate_hz, scale=scale, offset=offset)
    if played.file_rate_hz is not None:
        raise UnusableInputError(
            "stimulus.file_rate",
            "{path} is a saved stimulus and has its sample rate: leave out --file-rate",
            path=str(path),
        )
    loaded = load_stimulus(path)
    if played.scale is None and played.offset is None:
        return loaded
    described = loaded.describe() if isinstance(loaded, FeedbackKind) else loaded.description
    inner = dict(described.get("stimulus", described)) if described.get("type") == GUIDED else dict(described)
    if inner.get("type") == Scaled.name:  # scaled twice: a (b x + c) + d
        scale, offset = scale * inner["scale"], scale * inner["offset"] + offset
        inner = dict(inner["stimulus"])
    scaled = Scaled.from_options({"stimulus": inner, "scale": scale, "offset": offset})
    preload_s = 0.0 if isinstance(loaded, FeedbackKind) else loaded.preload_s
    return build_from_specification(scaled, preload_s or None)


def playable_file(path: Path, sample_rate_hz: float, played: FilePlayback = _AS_IT_IS) -> Stimulus | FeedbackKind:
    """Return a stimulus from a file for an instrument of this sample rate; adds a preload if it has none.

    Raises:
        UnusableInputError: the file cannot be read, or contains no stimulus that this version can build.
    """
    loaded = stimulus_from_file(path, sample_rate_hz, played)
    if isinstance(loaded, FeedbackKind) or loaded.preload_s > 0.0:
        return loaded
    return with_preload(loaded, PRELOAD_S)


def test_kind(stimulus: Stimulus | FeedbackKind) -> str:
    """Return the kind of a test on tissue with this stimulus, as stored in a session."""
    kind = stimulus if isinstance(stimulus, FeedbackKind) else parse_description(stimulus.description)[0]
    return kind.inner.test_kind if isinstance(kind, Scaled) else kind.test_kind


test_kind.__test__ = False  # type: ignore[attr-defined]  # keeps pytest from collecting it
