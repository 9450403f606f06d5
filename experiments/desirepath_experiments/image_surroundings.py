"""What the steps of an image see of this machine: where its apt gets packages, pip's settings, its certificates.

How that gets into the image's folder is `image_here.py`'s.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

PASSED_ON = ("PIP_", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE", "http_proxy", "https_proxy", "no_proxy")
CERTIFICATES = ("PIP_CERT", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE")  # of the variables passed on
TRUSTED = Path("/run/certificates")  # inside; packages' own scripts write to the usual place
SETTINGS_OF_PIP = (Path("/etc/pip.conf"), Path("~/.config/pip/pip.conf"))
CERTIFICATE_SETTING = re.compile(r"^cert\s*=\s*(\S+)\s*$", re.MULTILINE)


def passed_on() -> dict[str, str]:
    """The variables of this machine that a step has, its certificates where a step finds them."""
    known = {name: value for name, value in os.environ.items() if name.startswith(PASSED_ON)}
    return known | {name: str(TRUSTED / name) for name in certificates()}


def places_of_packages() -> list[Path]:
    """Pip's settings, and the files and folders that these and its variables name, certificates left out."""
    settings = [file for one in SETTINGS_OF_PIP if (file := one.expanduser()).exists()]
    said = [value for name, value in os.environ.items() if name.startswith("PIP_") and name not in CERTIFICATES]
    said += [CERTIFICATE_SETTING.sub("", file.read_text(encoding="utf-8")) for file in settings]
    return sorted({*settings, *(one for words in said for one in places_named(words) if one.exists())})


def certificates() -> dict[str, Path]:
    """The files of certificates that this machine's settings name, by the variable that says so inside."""
    found = {name: Path(os.environ[name]) for name in CERTIFICATES if os.environ.get(name)}
    for one in SETTINGS_OF_PIP:
        if one.expanduser().exists() and (said := CERTIFICATE_SETTING.search(one.expanduser().read_text("utf-8"))):
            found.setdefault("PIP_CERT", Path(said[1]))
    return {name: place for name, place in found.items() if place.is_file()}


def places_named(settings: str) -> list[Path]:
    """The files and folders of this machine that a variable's value or a settings file of pip names.

    An index's packages lie beside it (`simple/` and `files/`), so of an index it is the folder that holds both.
    """
    words = [word.removeprefix("file://") for word in settings.split()]
    places = [Path(word) for word in words if word.startswith("/")]
    return [one.parent if one.name == "simple" else one for one in places]


def sites_of_apt() -> list[tuple[str, str]]:
    """Where this machine's apt gets Debian's main packages, and of which release."""
    asked = ["apt-get", "indextargets", "--format", "$(SITE)|$(CODENAME)|$(COMPONENT)|$(CREATED_BY)"]
    said = subprocess.run(asked, capture_output=True, text=True, check=True).stdout
    found = [line.split("|") for line in said.splitlines()]
    return [(site, of) for site, of, component, kind in found if (component, kind) == ("main", "Packages")]
