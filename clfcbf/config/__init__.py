"""A robot's whole configuration in one TOML file, made of the library's own dataclasses."""

from clfcbf.config.findings import Finding, Severity, findings
from clfcbf.config.model import Config
from clfcbf.config.reading import parse_config, read_config
from clfcbf.config.writing import template, to_toml

__all__ = [
    "Config",
    "Finding",
    "Severity",
    "findings",
    "parse_config",
    "read_config",
    "template",
    "to_toml",
]
