"""Options of a command that are the fields of a configuration class: name, type, default, limits and help from there.

The class is named, not imported: it may need torch, and `--help` of all commands is quick. It is looked at when the
command is chosen.
"""

from __future__ import annotations

import functools
import inspect
import pkgutil
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer
from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from typer.core import TyperCommand

from desirepath.grammar.configuration import limits_of, read_fields

RANGE = re.compile(r"(\d+)-(\d+)")


@dataclass(frozen=True)
class OptionsOf:
    """The fields of a class as options. A tuple is written with commas, whole numbers also as FIRST-LAST.

    config: the class, frozen dataclass or Pydantic model, as `package.module:Class`. names: what an option is called
    where it is not its field's name with dashes; several with commas. without: fields that the command sees to. given:
    what the command gives the class at first. help_of: what a field is for, where its description does not say it.
    """

    config: str
    names: Mapping[str, str] = field(default_factory=dict)
    without: tuple[str, ...] = ()
    given: Mapping[str, Any] = field(default_factory=dict)
    help_of: Callable[[str], str | None] = lambda name: None

    @functools.cached_property
    def made(self) -> type[Any]:
        """The class itself, imported."""
        made: type[Any] = pkgutil.resolve_name(self.config)
        return made

    @functools.cached_property
    def taken(self) -> dict[str, FieldInfo]:
        """The fields that are options."""
        left_out = {*self.without, *self.given}
        return {name: info for name, info in read_fields(self.made).items() if name not in left_out}

    def parameters(self) -> list[inspect.Parameter]:
        """As a command's function would have them."""
        return [self._parameter(name, info) for name, info in self.taken.items()]

    def read(self, values: dict[str, Any]) -> Any:
        """An object of the class; takes its fields out of what the command was called with. Raises ValueError."""
        asked = {name: _read(info.annotation, values.pop(name), name) for name, info in self.taken.items()}
        try:
            return self.made(**{**self.given, **asked})
        except ValidationError as wrong:
            problem = wrong.errors(include_url=False)[0]
            name = ".".join(str(part) for part in problem["loc"])
            raise ValueError(f"{self._flags(name)[0]} {problem['input']}: {problem['msg']}") from None

    def _flags(self, name: str) -> list[str]:
        given = self.names.get(name)
        return given.split(",") if given else [f"--{name.replace('_', '-')}"]

    def _parameter(self, name: str, info: FieldInfo) -> inspect.Parameter:
        annotation, default = info.annotation, info.get_default(call_default_factory=True)
        flags = self._flags(name)
        if get_origin(annotation) is tuple:
            default = ",".join(str(item) for item in default) if default is not PydanticUndefined else default
            annotation = str
        if annotation is bool and default:
            flags = [f"{flags[0]}/--no-{flags[0].removeprefix('--')}"]
        least, most = limits_of(info)
        words = info.description or self.help_of(name)
        if annotation is Path and default is PydanticUndefined:  # what a command is about: DIR, not --folder DIR
            return inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, annotation=Annotated[Path, typer.Argument(help=words)]
            )
        option = typer.Option(*flags, min=least, max=most, help=words)
        return inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if default is PydanticUndefined else default,
            annotation=Annotated[annotation, option],
        )


def _read(annotation: Any, value: Any, name: str) -> Any:
    """What was written for a field, as the class takes it."""
    if get_origin(annotation) is not tuple or not isinstance(value, str):
        return value
    kind, words = get_args(annotation)[0], [word for word in value.split(",") if word]
    if kind is not int:
        return tuple(kind(word) if isinstance(kind, type) else word for word in words)  # literals: read by the class
    numbers: list[int] = []
    for word in words:
        both = RANGE.fullmatch(word)
        if both is None and not word.isdecimal():
            raise ValueError(f"--{name.replace('_', '-')} {value}: whole numbers with commas, or FIRST-LAST")
        numbers += range(int(both[1]), int(both[2]) + 1) if both else [int(word)]
    return tuple(numbers)


def configured(**configs: OptionsOf) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A command whose parameters of these names are objects of configuration classes, made of options. Stands nearest
    to the function; the command is registered with `cls=Configured`."""

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def called(*args: Any, **kwargs: Any) -> None:
            for name, options in configs.items():
                kwargs[name] = options.read(kwargs)
            command(*args, **kwargs)

        for name in configs:  # of a class that is not imported yet
            command.__annotations__.pop(name, None)
        every = inspect.signature(command, eval_str=True)
        _sign(called, [parameter for parameter in every.parameters.values() if parameter.name not in configs])
        called.configs = configs.values()  # type: ignore[attr-defined]
        return called

    return decorated


class Configured(TyperCommand):
    """A `configured` command: has the options of its classes as soon as somebody looks at them."""

    def get_params(self, ctx: Any) -> Any:
        """Every parameter, those of the classes after the command's own."""
        command: Any = self.callback
        configs = command.__dict__.pop("configs", None)
        if configs is not None:

            @functools.wraps(command)
            def called(**kwargs: Any) -> None:
                command.__wrapped__(**kwargs)

            more = [parameter for options in configs for parameter in options.parameters()]
            own = list(inspect.signature(command.__wrapped__).parameters.values())
            end = next((k for k, parameter in enumerate(own) if parameter.name == "as_json"), len(own))
            _sign(called, [*own[:end], *more, *own[end:]])
            app = typer.Typer(add_completion=False)
            app.command()(called)
            whole = typer.main.get_command(app)
            self.params, self.callback = whole.params, whole.callback
        return super().get_params(ctx)


def _sign(function: Callable[..., None], parameters: list[inspect.Parameter]) -> None:
    """Give a function this signature, all by keyword, as typer calls it."""
    by_keyword = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in parameters]
    function.__signature__ = inspect.Signature(by_keyword)  # type: ignore[attr-defined]
    function.__annotations__ = {parameter.name: parameter.annotation for parameter in by_keyword}


RESPONSE_MODEL = OptionsOf(
    "desirepath.learning.preferences.oracles:ResponseModel",
    names={"lapse_rate": "--noise,--mistakes", "myopia_s": "--myopia"},
)
"""How a simulated participant's answers stray from its preference."""
