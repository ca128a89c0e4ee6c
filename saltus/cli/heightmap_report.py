"""`saltus heightmap report`: how wrong the predicted heights of recorded runs are, and where."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from saltus.cli.output import JsonOption, run_directory
from saltus.flags import AT_LEAST_ONE, shown


@dataclass(frozen=True, kw_only=True)
class Report(JsonOption):
    """Measures the heightmaps of recorded runs and writes one HTML file.

    Example: saltus heightmap report runs/one/recording.mcap --model geometric runs/heightmap/heightmap.onnx
    """

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional, AT_LEAST_ONE]
    """Recorded runs (.mcap), whole or damaged, with ground truth or without."""
    model: Annotated[tuple[str, ...], shown("MODEL [MODEL ...]", "none")] = ()
    """To compare, on the same depth: paths of ONNX files, "geometric" (deprojection), or "geometric-feet" (the same,
    its map held to the feet that stand)."""
    out: Annotated[Path | None, shown("PATH", "a new one, runs/DATE-heightmap-report")] = None
    """Folder for report.html."""

    def run(self) -> int:
        """Writes the file and prints the numbers."""
        from saltus.errors import RecordingError, SaltusError
        from saltus.heightmap.evaluation.report import centimetres, measure, write_report
        from saltus.recordings.recording import read_recording

        if not self.recordings:
            raise RecordingError("no recording: name at least one .mcap file")
        if self.out is not None and self.out.suffix:
            raise SaltusError(f"--out {self.out}: name a folder; report.html is written into it")
        report = measure([read_recording(path) for path in self.recordings], self.model)
        path = run_directory("heightmap-report", self.out) / "report.html"
        write_report(report, path)
        numbers = report.numbers()
        for run in numbers["runs"]:
            for item in run["lost"]:
                print(f"lost in {run['name']}: {item}")
        for reason in report.failed:
            print(f"not compared: {reason}")
        for name, row in numbers["predictors"].items():
            print(
                f"{name}: {centimetres(row['mae_m'])} cm, edges {centimetres(row['edge_error_m'])} cm, "
                f"90 % intervals cover {100 * row['coverage90']:.0f} %"
            )
        print(f"report    {path}")
        self.tell_json(numbers)
        return 0
