"""`saltus bench`: the measurements behind the numbers in the documentation."""

import ast
import importlib
from dataclasses import dataclass
from typing import Annotated

import tyro

from saltus.cli.checkout import checkout_root
from saltus.cli.output import print_figures, print_json
from saltus.cli.parsing import parse
from saltus.errors import SaltusError, check_known
from saltus.extras import install_command
from saltus.flags import flag_help


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Measures this machine: lists the benchmarks, or runs one of them.

    Each prints its figures; with --json one JSON object is the last line. They are part of a
    checkout, not of a wheel.

    For example:
      saltus bench
      saltus bench qp --help
      saltus bench qp -- --problems 200 --json
    """

    name: Annotated[tyro.conf.Positional[str], flag_help("NAME", "none, list them")] = ""
    """Which benchmark."""
    arguments: Annotated[tyro.conf.Positional[tuple[str, ...]], flag_help("...", "none")] = ()
    """Flags of the benchmark, after its name or after --."""

    def run(self) -> int:
        """Lists or runs."""
        folder = checkout_root("benchmarks/_command.py", "bench") / "benchmarks"
        files = {path.stem: path for path in folder.glob("[!_]*.py")}
        files |= {path.parent.name: path for path in folder.glob("*/command.py")}
        if not self.name:
            for name, path in sorted(files.items()):
                said = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
                summary = said.partition("\n\n")[0].replace("\n", " ")
                print(f"{name:16} {summary}")
            return 0
        check_known("there is no benchmark", self.name, files, error=SaltusError)
        file = files[self.name].relative_to(folder.parent)
        try:
            return self._measure(".".join(file.with_suffix("").parts))
        except ModuleNotFoundError as error:
            needed = f"the package '{error.name}', which is not installed"
            raise SaltusError(
                f"benchmark '{self.name}' needs {needed}: {install_command('train')}, or "
                f"what {file} says"
            ) from error

    def _measure(self, module: str) -> int:
        found = importlib.import_module(module)
        arguments = self.arguments[1:] if self.arguments[:1] == ("--",) else self.arguments
        prog = f"saltus bench {self.name}"
        benchmark = parse(found.Benchmark, arguments, prog=prog, description=found.__doc__ or "")
        figures = benchmark.measure()
        if benchmark.json:
            print_json(figures)
        else:
            getattr(benchmark, "show", print_figures)(figures)
        return 0
