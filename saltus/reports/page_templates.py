"""Templates, which make HTML of values. One stands beside the module whose values it shows."""

import base64
import math
from pathlib import Path

import jinja2

from saltus.arrays import AnyArray

TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent, encoding="utf-8"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
"""Text becomes HTML by itself; a name that nobody gave is an error."""


def data_url(kind: str, data: bytes | AnyArray) -> str:
    """A picture as the source of an <img>: the bytes of a file of this kind, e.g. "jpeg"."""
    return f"data:image/{kind};base64,{base64.b64encode(bytes(data)).decode()}"


def template_beside(module_file: str) -> jinja2.Template:
    """The template beside a module: `module_file` is its `__file__`."""
    return TEMPLATES.from_string(Path(module_file).with_suffix(".html").read_text(encoding="utf-8"))


TEMPLATES.filters["capital"] = lambda text: text[0].upper() + text[1:]  # the rest as it is
TEMPLATES.tests["finite"] = math.isfinite
TEMPLATES.globals["data_url"] = data_url
TEMPLATES.globals["table"] = TEMPLATES.get_template("table.html").module.table  # type: ignore[attr-defined]
