"""`saltus heightmap check`: can the heights of this robot be trusted?"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from saltus.cli.output import JsonOption
from saltus.cli.record import record
from saltus.config import check_between
from saltus.errors import RecordingError, SaltusError
from saltus.flags import EndpointOption, shown


@dataclass(frozen=True, kw_only=True)
class Check(EndpointOption, JsonOption):
    """Says whether the heights of a robot can be trusted; it must stand on level ground with nothing ahead.

    Rates, delays, where the camera sits, and the heights themselves: ahead, the ground is as high as under the feet.
    Ends with 0 where all is good, with 1 where something is not.

    For example:
      saltus heightmap check --run-dir runs/mine
      saltus heightmap check runs/standing/recording.mcap
    """

    recording: Annotated[Path | None, tyro.conf.Positional, shown("PATH", "none: a running stack")] = None
    """A recorded run (.mcap) in which the robot stands for a second or more."""
    run_dir: Annotated[Path | None, shown("PATH", "none: a recording")] = None
    """Folder of a running stack, with its run.toml."""
    seconds: float = 3.0
    """With --run-dir: how long to listen."""

    def run(self) -> int:
        """Prints one line for each thing that heights rest on, and a verdict."""
        from tempfile import TemporaryDirectory

        check_between(self, seconds=(0.5, 600.0))
        if self.recording is not None and self.run_dir is None:
            return self._judge(self.recording)
        if self.recording is not None or self.run_dir is None:
            raise SaltusError("heightmap check needs a recording, or --run-dir for a running stack, and not both")
        with TemporaryDirectory() as folder:
            heard = Path(folder) / "recording.mcap"

            def begin() -> Path:
                print(f"listening for {self.seconds:g} s", flush=True)
                return heard

            record(self.run_dir, self.endpoint, begin, self.seconds)
            try:
                return self._judge(heard)
            except RecordingError as error:  # the file that it names is about to vanish
                raise SaltusError(str(error).replace(str(heard), str(self.run_dir))) from error

    def _judge(self, path: Path) -> int:
        from saltus.heightmap.evaluation.standing import check_standing
        from saltus.recordings.recording import read_recording

        findings = check_standing(read_recording(path))
        for finding in findings:
            print(
                f"{'good' if finding.good else 'BAD ':5} {finding.name:26} {finding.measured}; wanted: {finding.wanted}"
            )
            if not finding.good:
                print(f"      {finding.cure}")
        bad = [finding.name for finding in findings if not finding.good]
        print(f"do not trust these heights: {', '.join(bad)}" if bad else "these heights can be trusted")
        self.tell_json({"trusted": not bad, "findings": [vars(finding) for finding in findings]})
        return 1 if bad else 0
