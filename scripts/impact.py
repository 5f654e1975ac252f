"""Drop the paper's link into play sand, step by step, and print when and where T stops.

python scripts/impact.py
"""

import math

import mujoco

import mjgranular
from mjgranular.models import model_path


def main() -> None:
    """Run one impact."""
    model = mujoco.MjModel.from_xml_path(str(model_path("link")))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("impact").id)  # 45 degrees, 10 m/s down

    sand = mjgranular.Sand(model, medium="play_sand")
    while True:
        sand.step(data)  # in place of mujoco.mj_step(model, data)
        body = sand.report(data)["link"]
        angle, omega = data.joint("q").qpos[0], data.joint("q").qvel[0]
        tip_velocity = -data.joint("z").qvel[0] - omega * 0.1 * math.sin(angle)  # of T, down
        if tip_velocity <= 0:
            break

    print(f"T stops after {data.time * 1e3:.2f} ms, {body.depth * 1e3:.2f} mm deep")
    print(f"the sand pushes with {body.force.round(1)} N at {(body.point * 1e3).round(1)} mm")


if __name__ == "__main__":
    main()
