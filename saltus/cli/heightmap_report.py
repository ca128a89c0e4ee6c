"""`saltus heightmap report`: how wrong the predicted heights of recorded runs are, and where."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from saltus.cli.output import print_json


@dataclass(frozen=True, kw_only=True)
class Report:
    """Measures the heightmaps of recorded runs and writes one HTML file."""

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Recorded runs (.mcap), whole or damaged, with ground truth or without."""
    model: tuple[str, ...] = ()
    """To compare, on the same depth: paths of ONNX files, "geometric" (deprojection), or "geometric-feet" (the same,
    its map held to the feet that stand)."""
    out: Path = Path("report.html")
    """The file to write."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print all numbers as one JSON object on the last line."""

    def run(self) -> int:
        """Writes the file and prints the numbers."""
        from saltus.errors import RecordingError
        from saltus.heightmap.evaluation.report import measure, write_report
        from saltus.recordings.recording import read_recording

        if not self.recordings:
            raise RecordingError("no recording: name at least one .mcap file")
        report = measure([read_recording(path) for path in self.recordings], self.model)
        write_report(report, self.out)
        numbers = report.numbers()
        for run in numbers["runs"]:
            for item in run["lost"]:
                print(f"lost in {run['name']}: {item}")
        for reason in report.failed:
            print(f"not compared: {reason}")
        for name, row in numbers["predictors"].items():
            print(
                f"{name}: {100 * row['mae_m']:.2f} cm, edges {100 * row['edge_error_m']:.2f} cm, "
                f"90 % intervals cover {100 * row['coverage90']:.0f} %"
            )
        print(f"report    {self.out}")
        if self.json:
            print_json(numbers)
        return 0
