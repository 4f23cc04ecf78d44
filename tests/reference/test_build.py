"""What ``make firmware`` builds, checks and says, with and without the tools."""

import shutil

import pytest

from firmware_sim.reference import build, tools


def test_what_is_missing_is_named_and_is_no_failure(monkeypatch, capsys):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert build.main() == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "posix: not built, install one of cc, gcc, clang",
        "qemu: not built, install arm-none-eabi-gcc",
        "stm32h743: not built, install arm-none-eabi-gcc",
        "static analysis: not run, install cppcheck",
    ]


def test_a_tool_is_the_first_that_is_installed(monkeypatch):
    monkeypatch.setattr(shutil, "which", {"b": "/b", "c": "/c"}.get)
    assert tools.tool("x: not built", "a", "b", "c") == "/b"
    with pytest.raises(tools.MissingToolError, match=r"^x: not built, install a$"):
        tools.tool("x: not built", "a")


def test_static_analysis_is_clean():
    if shutil.which("cppcheck") is None:
        pytest.skip("needs cppcheck")
    assert build.static_analysis() == 0


def test_warnings_are_errors():
    try:
        with pytest.raises(RuntimeError, match="unused"):
            build.build_posix(replaced={"outbox.c": '#include "outbox.h"\nstatic int unused;\n'})
    except tools.MissingToolError as error:
        pytest.skip(str(error))
