"""A HEIC file as a phone writes it, which no library at hand can write."""

from __future__ import annotations

import base64
from pathlib import Path

SIZE = (128, 96)
"""Width and height in pixels, as the sensor has them."""
QUARTERS = {"top left": (200, 40, 40), "top right": (40, 200, 40), "bottom left": (40, 40, 200)}
"""RGB in the sensor's orientation; the last quarter is (200, 200, 200)."""
_FILE = """
AAAAHGZ0eXBoZWljAAAAAG1pZjFoZWljbWlhZgAAAaFtZXRhAAAAAAAAACFoZGxyAAAAAAAAAABwaWN0AAAAAAAAAAAAAAAAAAAA
ADRpbG9jAAAAAERAAAIAAQAAAAABxQABAAAAAAAAAQcAAgAAAAACzAABAAAAAAAAAH4AAAA4aWluZgAAAAAAAgAAABVpbmZlAgAA
AAABAABodmMxAAAAABVpbmZlAgAAAQACAABFeGlmAAAAAA5waXRtAAAAAAABAAAA4GlwcnAAAADAaXBjbwAAAHhodmNDAQNwAAAA
kAAAAAAAHvAA/P34+AAADwNgAAEAGEABDAH//wNwAAADAJAAAAMAAAMAHroCQGEAAQArQgEBA3AAAAMAkAAAAwAAAwAeoBAgYWW6
kkprm4CGgwIAAAMAMgAAAwACEGIAAQAHRAHBcrAiQAAAABNjb2xybmNseAABAA0ABoAAAAAUaXNwZQAAAAAAAACAAAAAYAAAABBw
aXhpAAAAAAMICAgAAAAJaXJvdAMAAAAYaXBtYQAAAAAAAAABAAEFgQIDBIUAAAAaaXJlZgAAAAAAAAAOY2RzYwACAAEAAQAAAY1t
ZGF0AAABAygBrwng4wucuq///jSf//39B5D9go04hm4h5R//ytRFf0/7R/4mbFPu+u3hZL/haBbEgJDC3NUKj9Ze3UImUdm2i7L+
//syR3/Iylf/St0Rz7HzvKhVCVssvZWtYf7pq9WG1ry9WPrXrio7LGtbnr8S/5pr/8lCnT0fPhesg7dP+0uHbg17/3ciRk32pfCP
InUKKDNRW/0sESlWcahe7ui7Pb8w4mhCK1f2AfEABu2SpUfjgbEihtP+BiOn6YbLS2AvQAJsUEt2dqo1IEDP0ejuo1W2A8H4AlQA
NyawLI+CD/2vOiOQbntXcLGboeIAMN8dYcisSHecivb12fPEqhiLckAAAAAGRXhpZgAATU0AKgAAAAgABAEPAAIAAAAGAAAAPgEQ
AAIAAAAKAAAARAESAAMAAAABAAYAAIdpAAQAAAABAAAATgAAAABBcHBsZQBpUGhvbmUgMTUAAAKSCgAMAAAAAQAAAGykBQADAAAA
AQAYAAAAAAAAQBoAAAAAAAA=
"""


def write_heic(path: Path, *, turned: bool = True, tag: int = 6) -> None:
    """Write the photograph, held upright, by an "iPhone 15": turned by its box `irot`, or not, and with the EXIF
    Orientation `tag`."""
    content = bytearray(base64.b64decode(_FILE))
    entry = b"\x01\x12\0\x03\0\0\0\x01\0"  # of the Orientation, before its value
    content[content.index(entry) + len(entry)] = tag
    content[content.index(b"irot") + 4] = 3 if turned else 0
    path.write_bytes(content)
