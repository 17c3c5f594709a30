"""A person and its landmarks, without any picture."""

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from dress_jax.body.poses import named_pose
from dress_jax.body.skeleton import joint_index
from dress_jax.reconstruction.landmarks import landmark_points
from dress_jax.reconstruction.parameters import make_parameters
from dress_jax.render.cameras import look_at_camera, project, stack_cameras
from dress_jax.render.rings import magicman_cameras

CENTER = np.array([0.0, 0.9, 0.0])


def person(model, *, seed=0):
    """A tall person with bent elbows and a knee up, looking to the right."""
    rng = np.random.default_rng(seed)
    pose = named_pose("a")
    pose[joint_index("left_elbow"), 1] = -0.8
    pose[joint_index("right_elbow"), 1] = 0.4
    pose[joint_index("left_hip"), 0] = -0.6
    pose[joint_index("left_knee"), 0] = 0.8
    pose[0] = Rotation.from_euler("yx", [-40.0, 8.0], degrees=True).as_rotvec()
    return make_parameters(
        model,
        pose=pose,
        shape=0.7 * rng.normal(size=model.shapedirs.shape[2]),
        scale=1.1,
        translation=np.array([0.05, 0.95, -0.04]),
    )


def ring(count=4, *, size=128):
    """Orthographic cameras about a person."""
    return stack_cameras(magicman_cameras(count, center=CENTER, half_extent=1.25, size=size))


def pinhole_ring(count=4, *, size=128):
    """Perspective cameras four metres away."""
    angles = 2.0 * np.pi * np.arange(count) / count
    eyes = CENTER + 4.0 * np.stack([np.sin(angles), 0.1 + 0 * angles, np.cos(angles)], axis=1)
    return stack_cameras(
        [look_at_camera(eye, CENTER, vertical_angle=0.65, height=size) for eye in eyes]
    )


def seen_landmarks(mapping, parameters, *, cameras=None):
    """Cameras, exact positions (v, k, 2) [px], and numbers of the landmarks."""
    cameras = ring() if cameras is None else cameras
    points = landmark_points(mapping, parameters)
    column, row, _ = jax.vmap(lambda camera: project(camera, points))(cameras)
    return cameras, np.stack([column, row], axis=2), np.array(mapping.indices)
