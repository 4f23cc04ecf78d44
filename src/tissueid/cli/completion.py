"""``tissueid completion``: completion of commands, options and their values in a shell.

The script holds all names, so that a completion does not start Python.
"""

from __future__ import annotations

import shlex
from typing import Literal

import typer

from tissueid.cli.command_reference import CommandText, OptionText, all_commands


def completion_script(shell: Literal["bash", "zsh", "fish"], app: typer.Typer) -> str:
    """Return the completion script of a shell for the commands of ``app``."""
    commands = {command.words: command for command in all_commands(app)}
    return {"bash": _bash, "zsh": _zsh, "fish": _fish}[shell](commands)


def _bash(commands: dict[tuple[str, ...], CommandText]) -> str:
    lines = [
        "# tissueid completion bash > ~/.local/share/bash-completion/completions/tissueid",
        "_tissueid() {",
        "    local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]}",
        "    local command= item words= options= values= files=",
        '    for item in "${COMP_WORDS[@]:1:COMP_CWORD-1}"; do',
        '        case "$command $item" in',
    ]
    for words in filter(None, commands):
        command = shlex.quote(_joined(words))
        lines.append(f"            {command}) command={command} ;;")
    lines += ["        esac", "    done", '    case "$command" in']
    for words, found in commands.items():
        names = [*found.subcommands, *(choice for item in found.arguments for choice in item.choices)]
        options = [name for option in found.options for name in option.names]
        quoted = f"words={shlex.quote(' '.join(names))} options={shlex.quote(' '.join(options))}"
        lines.append(f"        {shlex.quote(_joined(words))}) {quoted} files={'' if names else 1} ;;")
    lines += ["    esac", '    case "$command $before" in']
    for words, found in commands.items():
        for option in (item for item in found.options if item.takes_value):
            patterns = "|".join(shlex.quote(f"{_joined(words)} {name}") for name in option.names)
            files = "" if option.choices else "files=1 "
            lines.append(f"        {patterns}) words= {files}values={shlex.quote(' '.join(option.choices))} ;;")
    return "\n".join([*lines, _BASH_END])


_BASH_END = """\
    esac
    if [ -n "$values" ]; then
        COMPREPLY=($(compgen -W "$values" -- "$word"))
    elif [[ $word == -* ]]; then
        COMPREPLY=($(compgen -W "$options" -- "$word"))
    else
        COMPREPLY=($(compgen -W "$words" -- "$word"))
        [ -z "$files" ] || COMPREPLY+=($(compgen -f -- "$word"))
    fi
}
complete -o filenames -F _tissueid tissueid
"""


def _joined(words: tuple[str, ...]) -> str:
    return "".join(f" {word}" for word in words)


def _zsh(commands: dict[tuple[str, ...], CommandText]) -> str:
    lines = [
        "#compdef tissueid",
        "# Completion of tissueid for zsh: tissueid completion zsh > a folder of $fpath/_tissueid",
    ]
    for words, command in commands.items():
        lines += [f"{_function(words)}() {{", "    local context state state_descr line", "    typeset -A opt_args"]
        parts = [_zsh_option(name, option) for option in command.options for name in option.names]
        if command.subcommands:
            parts += ["'1: :->command'", "'*::argument:->arguments'"]
        elif command.arguments:
            choices = " ".join(choice for item in command.arguments for choice in item.choices)
            parts.append(f"'*:value:({choices})'" if choices else "'*:file:_files'")
        lines.append("    _arguments -C " + " ".join(parts))
        if command.subcommands:
            described = " ".join(
                shlex.quote(f"{name}:{_first(commands[(*words, name)].help)}") for name in command.subcommands
            )
            lines += [
                "    case $state in",
                f"        command) local -a names=({described}); _describe command names ;;",
                "        arguments) case $line[1] in",
                *(f"            {name}) {_function((*words, name))} ;;" for name in command.subcommands),
                "        esac ;;",
                "    esac",
            ]
        lines.append("}")
    return "\n".join([*lines, '_tissueid "$@"']) + "\n"


def _function(words: tuple[str, ...]) -> str:
    return "_".join(("_tissueid", *(word.replace("-", "_") for word in words)))


def _zsh_option(name: str, option: OptionText) -> str:
    about = option.help.translate(str.maketrans("[]:", "();"))
    text = f"*{name}[{about}]"
    if option.choices:
        text += f":value:({' '.join(option.choices)})"
    elif option.takes_value:
        text += ":file:_files" if option.takes_file else ":value: "
    return shlex.quote(text)


def _fish(commands: dict[tuple[str, ...], CommandText]) -> str:
    lines = ["# tissueid completion fish > ~/.config/fish/completions/tissueid.fish"]
    for words, command in commands.items():
        given = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in words) or "true"
        if command.subcommands:
            inside = f"{given}; and not __fish_seen_subcommand_from {' '.join(command.subcommands)}"
            for name in command.subcommands:
                about = _first(commands[(*words, name)].help)
                lines.append(f"complete -c tissueid -f -n {shlex.quote(inside)} -a {name} -d {shlex.quote(about)}")
        for option in command.options:
            for name in option.names:
                line = (
                    f"complete -c tissueid -n {shlex.quote(given)} -l {name.lstrip('-')} -d {shlex.quote(option.help)}"
                )
                if option.choices:
                    line += f" -x -a {shlex.quote(' '.join(option.choices))}"
                elif option.takes_value:
                    line += " -r"
                lines.append(line)
    return "\n".join(lines) + "\n"


def _first(text: str) -> str:
    """Return the first sentence of a help without its full stop."""
    return text.split(". ")[0].removesuffix(".").split("\n")[0]
