"""What stands at the head of a log and at its end: configuration, versions, counts."""

from __future__ import annotations

import hashlib
import json
import platform
import time
from collections.abc import Mapping

import numpy as np

import clfcbf
from clfcbf import defaults
from clfcbf.recorder.blueprint import Configuration, configuration_to_json

__all__ = [
    "FORMAT",
    "HEADER",
    "TASK_TOPIC",
    "TICK_TOPIC",
    "TRAILER",
    "header_of",
    "is_sealed",
    "platform_versions",
    "sealed",
]

FORMAT = "1"
"""Of the log; a reader refuses another."""

HEADER, TRAILER = "clfcbf.header", "clfcbf.trailer"
"""Names of the metadata records at both ends of a log."""

TICK_TOPIC, TASK_TOPIC = "/clfcbf/tick", "/clfcbf/task"


def header_of(configuration: Configuration) -> dict[str, str]:
    """What stands at the head of a log: the configuration, and what computed with it."""
    return sealed(
        {
            "format": FORMAT,
            "controller": type(configuration).__name__,
            "configuration": configuration_to_json(configuration),
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "defaults": defaults.fingerprint(),
            **platform_versions(),
        }
    )


def platform_versions() -> dict[str, str]:
    """What a float may depend on: versions, and the machine with its mathematical library."""
    libc = " ".join(platform.libc_ver()).strip()
    return {
        "clfcbf": clfcbf.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": f"{platform.system()} {platform.machine()} {libc}".strip(),
    }


def sealed(content: Mapping[str, str]) -> dict[str, str]:
    """The content with its own SHA-256, for MCAP has no checksum of metadata."""
    plain = {name: text for name, text in content.items() if name != "sha256"}
    text = json.dumps(plain, sort_keys=True)
    return {**plain, "sha256": hashlib.sha256(text.encode()).hexdigest()}


def is_sealed(content: Mapping[str, str]) -> bool:
    """Whether the content is as it was when it was sealed."""
    return dict(content) == sealed(content)
