"""The layout for Foxglove fits what recordings hold."""

import json
import re
from pathlib import Path

from saltus.recordings import viewer
from saltus.recordings.ros_messages import STORE

LAYOUT = Path(__file__).parents[2] / "docs" / "foxglove_layout.json"


def test_the_layout_names_only_what_is_there() -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    panels = layout["configById"]
    named, fields = set(), []
    for config in panels.values():
        named |= set(config.get("topics", {}))
        named |= {config[key] for key in ("topicToRender",) if key in config}
        named |= {
            value for key, value in config.get("imageMode", {}).items() if key.endswith("Topic")
        }
        fields += [path["value"].split(".") for path in config.get("paths", ())]
    assert named | {topic for topic, _ in fields} <= set(viewer.TOPICS)
    assert set(viewer.TOPICS) - named - {"/viewer/numbers", "/viewer/tf", "/viewer/depth"} == set()
    for topic, field in fields:
        assert field in STORE.types[viewer.TOPICS[topic][0]].__dataclass_fields__
    shown = set(re.findall(r'"([A-Za-z0-9]+![a-z]+)"', json.dumps(layout["layout"])))
    assert shown == set(panels)
    grid = panels["3D!robot"]["topics"]["/viewer/grid_map"]
    assert (grid["elevationLayer"], grid["colorLayer"]) == ("elevation", "variance")
