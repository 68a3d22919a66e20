"""MuJoCo's time for a picture of an exported scene on a software renderer, for `fiatlux-bench camera`.

    python3 tests/oracle/camera.py SCENE.xml...

Draws with EGL on Mesa's llvmpipe in the calling thread, with MuJoCo's default look, shadows included. Needs libEGL and Mesa's drivers (Debian:
libegl1, libgl1-mesa-dri); MUJOCO_GL=osmesa takes libOSMesa in place of it. Reads requests from its input, one a line:
`SCENE WIDTH HEIGHT SECONDS`, where SCENE is the place of a file among the arguments, and answers each with a line of JSON: milliseconds of
processor time a picture. Makes its own virtual environment on the first run.
"""

import json
import os
import sys
import time
from pathlib import Path

import environment

HERE = Path(__file__).resolve().parent
CAMERA = "head_camera"

environment.enter(__file__, HERE / ".venv", HERE / "requirements.txt")

# Before the libraries are loaded: no graphics card, and no threads of the renderer's own.
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ["LIBGL_ALWAYS_SOFTWARE"] = "1"
os.environ["LP_NUM_THREADS"] = "0"

import mujoco  # noqa: E402


class Scene:
    """A scene at its start."""

    def __init__(self, path):
        self.model = mujoco.MjModel.from_xml_path(path)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        mujoco.mj_forward(self.model, self.data)
        self.renderers = {}

    def draw(self, width, height):
        if (height, width) not in self.renderers:
            self.renderers[height, width] = mujoco.Renderer(self.model, height, width)
        renderer = self.renderers[height, width]
        renderer.update_scene(self.data, CAMERA)
        return renderer.render()


def main():
    scenes = [Scene(path) for path in sys.argv[1:]]
    for line in sys.stdin:
        index, width, height = map(int, line.split()[:3])
        seconds = float(line.split()[3])
        scene = scenes[index]
        picture = scene.draw(width, height)
        if picture.std() < 1:
            sys.exit(f"{sys.argv[1 + index]}: MuJoCo's picture is of one colour; is the renderer a real one?")
        begun, count = time.process_time(), 0
        while count == 0 or time.process_time() - begun < seconds:
            scene.draw(width, height)
            count += 1
        print(json.dumps({"milliseconds": (time.process_time() - begun) / count * 1e3}), flush=True)


main()
