"""Texts as editors leave them, and folders of robots as people have them:
read rightly, or refused by one line.
"""

from pathlib import Path

import pytest

from saltus.config import TOML_MAX
from saltus.depth_camera import load_camera
from saltus.errors import SaltusError
from saltus.robots.loading import load_robot

CAMERA = 'name = "mine"  # 30 \u00b0, \u4e00\ncamera_pitch = 0.51\nrate_hz = 31.0\n'
NOT_UTF8 = "it is not text in UTF-8"
NOT_TOML = "not valid TOML"
TEXTS: dict[str, tuple[bytes, str | None]] = {
    "as written": (CAMERA.encode(), None),
    "with a mark": (b"\xef\xbb\xbf" + CAMERA.encode(), None),
    "lines of Windows": (CAMERA.replace("\n", "\r\n").encode(), None),
    "a mark and lines of Windows": (b"\xef\xbb\xbf" + CAMERA.replace("\n", "\r\n").encode(), None),
    "no last line break": (CAMERA.rstrip().encode(), None),
    "many empty lines": (b"\n" * 9000 + CAMERA.encode(), None),
    "utf-16": (CAMERA.encode("utf-16"), NOT_UTF8),
    "utf-16, big end first": (b"\xfe\xff" + CAMERA.encode("utf-16-be"), NOT_UTF8),
    "utf-16 without a mark": ("rate_hz = 31.0\n".encode("utf-16-le"), NOT_TOML),
    "latin-1": (CAMERA.replace("\u4e00", "").encode("latin-1"), NOT_UTF8),
    "code page 1252": (CAMERA.replace("\u4e00", "\u201c").encode("cp1252"), NOT_UTF8),
    "half a sign": (CAMERA.encode()[: CAMERA.encode().index(b"\xb0")], NOT_UTF8),
    "zeros": (bytes(400), NOT_TOML),
    "a zero within": (CAMERA.encode().replace(b"31.0", b"31.0\0"), NOT_TOML),
    "JSON": (b'{"name": "mine"}', NOT_TOML),
    "YAML": (b"name: mine\nrate_hz: 31\n", NOT_TOML),
    "a decimal comma": (CAMERA.replace("31.0", "31,0").encode(), NOT_TOML),
    "curly quotes": (CAMERA.replace('"', "\u201d").encode(), NOT_TOML),
    "twice": (CAMERA.encode() * 2, NOT_TOML),
    "a sign too many": (b"#" * (TOML_MAX + 1), "longer than"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_a_toml_has_its_values_or_is_refused_by_one_line(name: str, tmp_path: Path) -> None:
    content, refusal = TEXTS[name]
    path = tmp_path / "c\u00e4mera.toml"
    path.write_bytes(content)
    if refusal is None:
        camera = load_camera(str(path))
        assert (camera.camera_pitch, camera.rate_hz) == (0.51, 31.0)
        return
    with pytest.raises(SaltusError, match=refusal) as caught:
        load_camera(str(path))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


MODEL = load_robot("go1").mjcf
FREE = "<freejoint name='base' />"
SECOND = '<body name="ball" pos="3 0 1"><freejoint/><geom size="0.1" mass="1"/></body></worldbody>'
TOML = 'name = "mio"  # m\u00edo\n'
FOLDERS: dict[str, tuple[dict[str, bytes], str | None]] = {
    "as they should be": ({"robot.toml": TOML.encode(), "m.xml": MODEL.encode()}, None),
    "a TOML with a mark": ({"robot.toml": b"\xef\xbb\xbf" + TOML.encode(), "m.xml": MODEL.encode()},
        None),
    "lines of Windows": (
        {"robot.toml": TOML.replace("\n", "\r\n").encode(),
            "m.xml": MODEL.replace("\n", "\r\n").encode()}, None
    ),
    "one of two is named": (
        {"robot.toml": (TOML + 'mjcf = "m.xml"\n').encode(), "m.xml": MODEL.encode(), "n.xml": b""},
        None
    ),
    "two models": ({"robot.toml": TOML.encode(), "m.xml": MODEL.encode(), "n.xml": b""},
        "2 .xml files lie beside it"),
    "no model": ({"robot.toml": TOML.encode()}, "0 .xml files lie beside it"),
    "another is named": (
        {"robot.toml": (TOML + 'mjcf = "n.xml"\n').encode(), "m.xml": MODEL.encode()},
        "there is no file '.*n.xml'"
    ),
    "no TOML": ({"m.xml": MODEL.encode()},
        "there is no .*robot.toml: name its model, .*m.xml, or write robot.toml"),
    "nothing": ({}, "there is no .*robot.toml: put the robot's MJCF there"),
    "a TOML in Latin-1": ({"robot.toml": TOML.encode("latin-1"), "m.xml": MODEL.encode()},
        NOT_UTF8),
    "an empty model": ({"robot.toml": TOML.encode(), "m.xml": b""}, "m.xml"),
    "half a model": ({"robot.toml": TOML.encode(), "m.xml": MODEL.encode()[:900]}, "m.xml"),
    "a URDF": ({"robot.toml": TOML.encode(), "m.xml": b'<robot name="x"><link name="a"/></robot>'},
        "m.xml"),
    "a ball beside it": (
        {"robot.toml": TOML.encode(), "m.xml": MODEL.replace("</worldbody>", SECOND).encode()},
        "have a free joint each: give a model of the robot alone",
    ),
    "held": ({"robot.toml": TOML.encode(), "m.xml": MODEL.replace(FREE, "").encode()},
        "add <freejoint/> to it"),
}  # fmt: skip


@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_of_a_robot_is_read_or_refused_by_one_line(name: str, tmp_path: Path) -> None:
    contents, refusal = FOLDERS[name]
    folder = tmp_path / "m\u00edo"
    folder.mkdir()
    for file, content in contents.items():
        (folder / file).write_bytes(content)
    if refusal is None:
        robot = load_robot(str(folder))
        assert robot.name == "mio"
        assert robot.thigh_length == pytest.approx(load_robot("go1").thigh_length)
        return
    with pytest.raises(SaltusError, match=refusal) as caught:
        load_robot(str(folder))
    assert "\n" not in str(caught.value)
