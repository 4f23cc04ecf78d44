"""Parameters of a command, made from the options that a plan declares."""

from __future__ import annotations

import functools
import inspect
import operator
import types
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

import typer
from pydantic.fields import FieldInfo

from tissueid.cli.output import Output
from tissueid.plan_options import Option, OptionBounds, Plan, bounds_of, option_of

_JSON_FILE = inspect.Parameter(
    "json_file",
    inspect.Parameter.KEYWORD_ONLY,
    annotation=Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="write the result as JSON; - prints it")
    ],
    default=None,
)


def plan_command(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options of its function.

        def run_tests(plan: TestPlan, out: Output) -> None:

    A parameter whose type is a plan is replaced by the options of the plan, in their order, and an
    :class:`~tissueid.cli.output.Output` by ``--json``; the function is called with both. Other parameters are kept.
    The types must be known where the function is defined.
    """
    signature = inspect.signature(command, eval_str=True)
    plans: dict[str, type[Plan]] = {}
    outputs: list[str] = []
    parameters: list[inspect.Parameter] = []
    for name, parameter in signature.parameters.items():
        kind = parameter.annotation
        if isinstance(kind, type) and issubclass(kind, Plan):
            plans[name] = kind
            parameters += [_parameter(*item) for item in _options(kind).items()]
        elif kind is Output:
            outputs.append(name)
            parameters.append(_JSON_FILE)
        else:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

    @functools.wraps(command)
    def run(**values: Any) -> None:
        for name, plan in plans.items():
            values[name] = plan(**{field: _value(item, values.pop(field)) for field, item in _options(plan).items()})
        for name in outputs:
            values[name] = Output(values.pop(_JSON_FILE.name))
        command(**values)

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run


def _options(plan: type[Plan]) -> dict[str, FieldInfo]:
    options = ((name, field) for name, field in plan.model_fields.items() if option_of(field) is not None)
    return dict(sorted(options, key=lambda option: not option[1].is_required()))


def _parameter(name: str, field: FieldInfo) -> inspect.Parameter:
    option = option_of(field) or Option()
    bounds = bounds_of(field)
    least, most = (None if bound is None else _shown(bound, option) for bound in bounds[:2])
    values: dict[str, Any] = {"metavar": option.metavar, "help": option.help, "min": least, "max": most}
    if bounds.least_open or bounds.most_open:  # typer has no exclusive bounds
        shown = bounds._replace(least=least, most=most)
        values |= {"min": None, "max": None, "callback": _check_of(shown)}
        values["help"] += f" [{_range_text(shown)}]"
    kind: Any = _type(field.annotation, option)
    info = typer.Argument(**values) if option.argument else typer.Option(*filter(None, [option.name]), **values)
    default = inspect.Parameter.empty if field.is_required() else _default(field, option)
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=Annotated[kind, info], default=default)


def _range_text(bounds: OptionBounds) -> str:
    """Return the range of values as typer shows that of inclusive bounds, such as "0.0<x<=15.0"."""
    low, high = ("<" if is_open else "<=" for is_open in bounds[2:])
    if bounds.least is None:
        return f"x{high}{bounds.most}"
    if bounds.most is None:
        return f"x>{low[1:]}{bounds.least}"
    return f"{bounds.least}{low}x{high}{bounds.most}"


def _check_of(bounds: OptionBounds) -> Callable[[float | None], float | None]:
    """Return a callback of an option that refuses values out of bounds."""
    above, below = (operator.lt if is_open else operator.le for is_open in bounds[2:])

    def check(value: float | None) -> float | None:
        low = bounds.least is None or value is None or above(bounds.least, value)
        if not low or not (bounds.most is None or value is None or below(value, bounds.most)):
            raise typer.BadParameter(f"{value:g} is not in the range {_range_text(bounds)}")
        return value

    return check


def _type(annotation: Any, option: Option) -> Any:
    """Return the type that typer reads: a list for a tuple of any length, a text where the plan reads it."""
    if get_origin(annotation) in (Union, types.UnionType):
        others = [kind for kind in get_args(annotation) if kind is not type(None)]
        return _type(others[0], option) | None
    if option.separator:
        return str | None
    if get_origin(annotation) is tuple and get_args(annotation)[1:] == (...,):
        return list[get_args(annotation)[0] if option.read is None else str] | None  # type: ignore[misc]
    return annotation if option.read is None else str


def _default(field: FieldInfo, option: Option) -> Any:
    default = field.get_default(call_default_factory=True)
    if default == ():
        return None
    return _shown(default, option) if isinstance(default, int | float) and not isinstance(default, bool) else default


def _shown(value: float, option: Option) -> float:
    """Return a value of the field in the unit of the command line."""
    return value if option.scale == 1.0 else float(f"{value / option.scale:.12g}")


def _value(field: FieldInfo, given: Any) -> Any:
    """Return the value of a field from the value that typer read."""
    option = option_of(field) or Option()
    if given is None:
        return () if field.default == () else None
    if option.separator:
        given = [text.strip() for text in given.split(option.separator) if text.strip()]
    several = isinstance(given, list)
    values = given if several else [given]
    if option.read is not None:
        values = [option.read(value) for value in values]
    elif option.scale != 1.0:
        values = [float(f"{value * option.scale:.12g}") for value in values]
    return tuple(values) if several else values[0]
