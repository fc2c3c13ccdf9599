"""Composing a configuration with Hydra, and refusing one that is wrong or would run code of its own choosing.

Every plugin's options appear in Hydra as ``<kind>=<name>`` straight from its dataclass; nobody copies YAML. Hydra
itself instantiates what ``_target_`` (and logging's ``()`` and ``class``) name, so those are refused wherever they
name anything but Hydra's own parts.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from hydra import version as hydra_version
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.config_search_path import SearchPathQuery
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from dafw.core.config_loader import StudyLoader
from dafw.core.errors import ConfigurationError, OptionError, PluginError
from dafw.core.options import unknown_option
from dafw.core.registry import KINDS, registry
from dafw.core.schemas import register_schemas

# Names that Hydra may instantiate: launchers and sweepers installed as Hydra plugins, and logging's plain handlers.
HARMLESS = re.compile(
    r"hydra\._internal\.core_plugins\.basic_(launcher|sweeper)\.Basic(Launcher|Sweeper)"
    r"|hydra_plugins\.\w+\.\w+\.\w+(Launcher|Sweeper)"
    r"|logging\.(StreamHandler|FileHandler|NullHandler|Formatter)|colorlog\.ColoredFormatter"
)


def config_folder() -> Path:
    """Return the folder of the shipped configuration: inside an installed package, at the top of a checkout."""
    package = Path(__file__).resolve().parent.parent
    installed = package / "conf"
    return installed if installed.is_dir() else package.parent / "conf"


def _require_composable(kind: str, name: str) -> None:
    """Raise PluginError if a plugin does not exist or its options cannot be composed."""
    try:
        OmegaConf.structured(registry().schema(kind, name))
    except OmegaConfBaseException as error:
        reason = str(error).splitlines()[0]
        raise PluginError(f"{kind} '{name}': its options cannot be composed by Hydra: {reason}") from error


def study_hydra(more: Path | None = None) -> Hydra:
    """Return the Hydra that composes and launches studies; ``more`` is a folder with further configuration."""
    register_schemas()
    hydra_version.setbase("1.3")
    search_path = create_config_search_path(str(config_folder()))
    if more is not None:
        search_path.prepend("command-line", more.resolve().as_uri(), SearchPathQuery(provider="schema"))
    return Hydra("dafw", StudyLoader(search_path))


def compose(
    overrides: Sequence[str], more: Path | None = None, name: str = "config", hydra: Hydra | None = None
) -> DictConfig:
    """Compose a study with Hydra's own part under ``hydra``; raises ConfigurationError with a one-line message.

    To compose many studies, pass the same ``hydra``, made by ``study_hydra(more)``, each time: making it is slow.
    """
    hydra = hydra or study_hydra(more)
    try:
        config: DictConfig = hydra.compose_config(name, list(overrides), RunMode.RUN, from_shell=False)
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        raise explained(error) from error
    refuse_code(config)
    return config


def study_part(config: DictConfig) -> dict[str, Any]:
    """Return the study's plain values, without Hydra's part."""
    plain = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
    try:
        values = OmegaConf.to_container(plain, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise explained(error) from error
    if not isinstance(values, dict):
        raise ConfigurationError("the configuration is not a mapping")
    return {str(key): value for key, value in values.items()}


def require_fixed_folder(config: DictConfig, sweep: bool = False) -> None:
    """Raise ConfigurationError if a run that may go on would have another folder each time that it is started."""
    key = "sweep" if sweep else "run"
    place = OmegaConf.to_container(config.hydra[key], resolve=False)
    if isinstance(place, dict) and "${now:" in str(place.get("dir")):
        raise ConfigurationError(
            f"resume=auto needs a folder that is the same each time, and this one has the time in its name: "
            f"hydra.{key}.dir=FOLDER"
        )


def single_runs(overrides: Sequence[str]) -> Iterator[list[str]]:
    """Expand the overrides of a multirun into those of its jobs; raises ConfigurationError."""
    try:
        parsed = OverridesParser.create().parse_overrides(list(overrides))
    except HydraException as error:
        raise explained(error) from error
    choices = []
    for override in parsed:
        if override.is_sweep_override() and override.is_discrete_sweep():
            choices.append([f"{override.get_key_element()}={value}" for value in override.sweep_string_iterator()])
        elif not override.is_sweep_override():
            choices.append([str(override.input_line)])
    yield from (list(job) for job in product(*choices))


def quoted_override(key: str, value: str) -> str:
    """Return an override that sets an option to a text, quoted if need be in Hydra's grammar.

    Raises ConfigurationError if that grammar cannot say it.

    >>> quoted_override("model.site.file", "my site.geojson")
    "model.site.file='my site.geojson'"
    """
    if re.fullmatch(r"[A-Za-z_./][\w./-]*", value) and value.lower() not in ("null", "true", "false", "nan", "inf"):
        return f"{key}={value}"
    # A backslash stands for itself, except before a quote.
    quoted = re.sub(r"(\\*)('|\Z)", lambda end: 2 * end[1] + (r"\'" if end[2] else ""), value)
    override = f"{key}='{quoted}'"
    try:
        said = OverridesParser.create().parse_override(override).value()
    except HydraException:
        said = None
    if str(said) != value or "${" in value:
        raise ConfigurationError(f"{key}: Hydra's grammar cannot say {value!r}; give it another name")
    return override


def refuse_code(config: DictConfig) -> None:
    """Raise ConfigurationError if the configuration would make Hydra or logging call something by its dotted name."""
    container = OmegaConf.to_container(config, resolve=False)
    for path, key, value in _entries(container, ""):
        names_code = key in ("_target_", "()") or (key == "class" and "_logging." in path)
        if names_code and not (path.startswith("hydra.") and HARMLESS.fullmatch(str(value))):
            raise ConfigurationError(f"{path}: a configuration may not name code to be run, got {value!r}")


def _entries(node: Any, path: str) -> Iterator[tuple[str, str, Any]]:
    if isinstance(node, Mapping):
        for key, value in node.items():
            yield from _entries(value, f"{path}.{key}" if path else str(key))
            if not isinstance(value, Mapping | list):
                yield (f"{path}.{key}" if path else str(key)), str(key), value
    elif isinstance(node, list):
        for number, item in enumerate(node):
            yield from _entries(item, f"{path}[{number}]")


def advised(
    error: ConfigurationError, overrides: Sequence[str], more: Path | None = None, name: str = "config"
) -> ConfigurationError:
    """Return the error. If the model is not the experiment's own, name the experiments that use that model."""
    hydra = study_hydra(more)

    def model(*words: str) -> str | None:
        try:
            return str(hydra.compose_config(name, [*paths, *words], RunMode.RUN, from_shell=False).model.name)
        except (HydraException, OmegaConfBaseException):
            return None

    paths = [word for word in overrides if word.startswith("hydra.searchpath=")]
    chosen = model(*overrides)
    meant = model(*(word for word in overrides if re.match("[+~]*experiment\\b", word)))
    if chosen is None or chosen == meant or not any(word.startswith("model=") for word in overrides):
        return error
    there_are = hydra.config_loader.get_group_options("experiment", config_name=name, overrides=paths)
    fitting = [experiment for experiment in sorted(there_are) if model(f"experiment={experiment}") == chosen]
    hint = (
        f"try {' or '.join(f'experiment={experiment}' for experiment in fitting)}"
        if fitting
        else (
            f"no experiment has model '{chosen}': choose observer=, policy= and filter= that fit it, "
            f"dafw run '~experiment' model={chosen} observer=..."
        )
    )
    return type(error)(f"{error}; this study's parts are for model '{meant}': {hint}")


def explained(error: BaseException) -> ConfigurationError:
    """Return Hydra's error as one line that says what is accepted."""
    root: BaseException = error
    while root.__cause__ is not None and isinstance(root.__cause__, HydraException | OmegaConfBaseException):
        root = root.__cause__
    if (file := re.match(r"In '([^']+)': \w+ raised while composing", str(root))) and root.__context__ is not None:
        within = explained(root.__context__)
        return type(within)(f"{file[1]}: {within}")
    key = getattr(root, "full_key", None)
    options = getattr(root, "object_type", None)
    lines = [line.strip() for line in str(root).splitlines() if line.strip()]
    if key and isinstance(root, MissingMandatoryValue):
        place, last = _place(str(key), getattr(root, "parent_node", None)), str(key).rpartition(".")[2]
        return OptionError(f"{place}: option '{last}' must be given")
    if key and dataclasses.is_dataclass(options) and isinstance(options, type):
        if (last := str(key).rpartition(".")[2]) not in [f.name for f in dataclasses.fields(options)]:
            return OptionError(unknown_option(options, last, _place(str(key), getattr(root, "parent_node", None))))
        if re.search("is not Optional", lines[0]):
            return OptionError(f"option '{key}' must have a value, got null")
        if group := re.search(r"is not a subclass of \w+\. value: (.*)", lines[0]):
            return OptionError(f"'{key}' is a group of options, expected {key}.OPTION=VALUE, got {group[1]}")
        return OptionError(f"option '{key}': {lines[0]}")
    if missing := re.search(r"Could not find '(\w+)/([^']+)'", str(root)):
        return ConfigurationError(_unknown_choice(missing[1], missing[2], getattr(root, "options", None)))
    if "not in struct" in str(root) and key:
        hint = f"to add an entry to a mapping write +{key}=VALUE; a study of your own parts starts with '~experiment'"
        return ConfigurationError(f"there is no '{key}' here ({hint})")
    text = "; ".join(line for line in lines if not line.startswith(("full_key:", "object_type=", "reference_type=")))
    return ConfigurationError(f"{key}: {text}" if key and str(key) not in text else text)


def _place(key: str, node: Any) -> str:
    """Return where an option belongs, as ``build`` says it: ``model 'ad_ins', wind, basis``, or ``study``."""
    kind, *groups = key.split(".")[:-1] or ["study"]
    while node is not None and node._get_parent() is not None and node._key() != kind:
        node = node._get_parent()
    if kind not in ("study", "hydra"):
        kind = f"{kind} '{node['name']}'" if node is not None and "name" in node else f"study, {kind}"
    return ", ".join([kind, *groups])


def _unknown_choice(group: str, name: str, there_are: Sequence[str] | None) -> str:
    """Return a message that lists the available choices: plugins from the registry, everything else from Hydra."""
    if group in KINDS:
        try:
            _require_composable(group, name)
        except PluginError as error:
            shipped = sorted(set(there_are or ()) - set(registry().names(group)))
            return str(error) + (f"; configured ones: {', '.join(shipped)}" if shipped else "")
    return f"there is no {group} '{name}' (there are: {', '.join(sorted(there_are or ())) or 'none'})"
