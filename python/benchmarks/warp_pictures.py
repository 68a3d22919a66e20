"""Draws rows of a batch on a GPU with the renderer of ``mujoco_warp``, beside our own pictures of the same rows, and prints both rates.

The scene is the one that ``Env.to_mjcf`` exports: one room for all worlds, with its shapes and without the surfaces, the light and the textures
of our pictures. Its cameras are where ours are. The rows come from a batch that steps on the CPU.

pip install mujoco-warp pillow
python warp_pictures.py --task S06 --worlds 1024 --size 128 128 --out pictures.png

Run with mujoco_warp 4.0.0, mujoco 4.0.0 and warp 1.19.0: both pictures of a row show the same things at the same places. On one NVIDIA H200,
1,024 worlds: 142,000 pictures a second of 64 x 64, 48,300 of 128 x 128 (docs/notes/performance.md); kernels are compiled for some 10 s first.
"""

import argparse
import json
import time

import fiatlux
import mujoco
import numpy as np
import warp as wp
from PIL import Image

wp.config.log_level = wp.LOG_WARNING  # before mujoco_warp begins Warp, which then says no more
import mujoco_warp as mjw  # noqa: E402

CAMERAS = {"camera": "head_camera"}  # our sensors' names of the scene's cameras, where they differ


def scene(task, seed, sensor, size):
    """MuJoCo's model of a room, and the number of the sensor's camera there, with the sensor's angle of view."""
    env = fiatlux.Env(task)
    env.reset(seed=seed)
    model = mujoco.MjModel.from_xml_string(env.to_mjcf())
    camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERAS.get(sensor, sensor))
    focal = fiatlux.cameras(image_size=size)[sensor].matrix[1, 1]
    model.cam_fovy[camera] = np.degrees(2 * np.arctan(size[1] / 2 / focal))
    return model, camera


def batch(task, seed, sensor, size, count, steps):
    """Rows of a batch after some steps of random actions, as MuJoCo's ``qpos``, with our pictures and the seconds that they took."""
    worlds = fiatlux.VectorEnv(
        task, count, seeds=[seed], sensors=["proprioception", f"{sensor}@look"], image_size=size, observation="dict"
    )
    worlds.reset()
    random = np.random.default_rng(0)
    for _ in range(steps):
        worlds.step(random.uniform(-0.3, 0.3, worlds.action_space.shape).astype(np.float32))
    worlds.look([sensor])  # both renderers draw once before they are timed
    begun = time.perf_counter()
    pictures = worlds.look([sensor])[sensor]
    seconds = time.perf_counter() - begun
    kinematics = fiatlux.Kinematics(task, seed=seed)
    rows = [worlds.row(world) for world in range(count)]
    return rows, kinematics, np.array(pictures), seconds


def draw(model, camera, qpos, size, frames):
    """Pictures of all worlds (count x height x width x 3 bytes), and the seconds that one frame of all takes."""
    count, (width, height) = len(qpos), size
    m = mjw.put_model(model)
    d = mjw.make_data(model, nworld=count)
    context = mjw.create_render_context(
        model, nworld=count, cam_res=size, render_rgb=True, use_shadows=True, cam_active=[camera]
    )
    d.qpos.assign(qpos.astype(np.float32))

    def frame():
        # Poses, cameras and lights follow from the joints; nothing is stepped.
        mjw.kinematics(m, d)
        mjw.com_pos(m, d)
        mjw.camlight(m, d)
        mjw.refit_bvh(m, d, context)
        mjw.render(m, d, context)

    frame()
    wp.synchronize()
    begun = time.perf_counter()
    for _ in range(frames):
        frame()
    wp.synchronize()
    seconds = (time.perf_counter() - begun) / frames
    colours = wp.zeros((count, height, width), dtype=wp.vec3)
    mjw.get_rgb(context, 0, colours)
    return np.clip(255 * colours.numpy() + 0.5, 0, 255).astype(np.uint8), seconds


def main():
    args = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    args.add_argument("--task", default="S06")
    args.add_argument("--seed", type=int, default=3, help="of the room that all worlds share")
    args.add_argument(
        "--sensor", default="camera", help="camera, chest_camera, left_wrist_camera or right_wrist_camera"
    )
    args.add_argument("--worlds", type=int, default=1024)
    args.add_argument("--size", type=int, nargs=2, default=(128, 128), metavar=("WIDTH", "HEIGHT"))
    args.add_argument("--steps", type=int, default=10, help="random steps before the pictures")
    args.add_argument("--frames", type=int, default=20, help="frames that are timed")
    args.add_argument("--out", default="pictures.png", help="the first worlds: ours above, mujoco_warp's below")
    args.add_argument("--json", action="store_true")
    args = args.parse_args()
    size = tuple(args.size)

    model, camera = scene(args.task, args.seed, args.sensor, size)
    rows, kinematics, ours, seconds = batch(args.task, args.seed, args.sensor, size, args.worlds, args.steps)
    qpos = np.stack([kinematics.to_mujoco(*kinematics.state(row), model=model)[0] for row in rows])
    theirs, frame = draw(model, camera, qpos, size, args.frames)
    rates = {
        "ours, on the CPU's cores": args.worlds / seconds,
        f"mujoco_warp on {wp.get_device()}": args.worlds / frame,
    }
    if args.json:
        print(json.dumps({"pictures_per_s": rates}))
    else:
        print("\n".join(f"{name}: {rate:,.0f} pictures/s" for name, rate in rates.items()))
    shown = min(4, args.worlds)
    Image.fromarray(np.vstack([np.hstack(ours[:shown]), np.hstack(theirs[:shown])])).save(args.out)


if __name__ == "__main__":
    main()
