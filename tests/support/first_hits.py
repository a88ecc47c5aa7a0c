# SPDX-License-Identifier: GPL-3.0-or-later
"""What a camera sees of a mesh, by rays of Warp's own mesh queries: nothing of it is shared with the engine."""

import numpy as np
import warp as wp
from adaptive_terrain.cbt_terrain.view.view import PANORAMIC, View

wp.set_module_options({"enable_backward": False})


@wp.kernel
def cast_rays(
    mesh: wp.uint64, origins: wp.array(dtype=wp.vec3f), rays: wp.array(dtype=wp.vec3f), face: wp.array(dtype=wp.int32)
):
    i = wp.tid()
    found = wp.mesh_query_ray(mesh, origins[i], rays[i], 1.0e9)
    face[i] = -1
    if found.result:
        face[i] = found.face


def rays_of(view: View, placement: np.ndarray, columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """float64 [n, 3] each: where rays through an even grid of the frame begin, at the clip start, and their directions,
    in the terrain's own space."""
    if view.kind == PANORAMIC:
        lon, lat = np.meshgrid(np.linspace(-np.pi, np.pi, columns), np.linspace(-1.5, 1.5, rows))
        rays = np.stack([np.sin(lon) * np.cos(lat), np.sin(lat), -np.cos(lon) * np.cos(lat)], -1).reshape(-1, 3)
        begin = rays * view.clip[0]
    else:
        x, y = np.meshgrid(np.linspace(-0.999, 0.999, columns), np.linspace(-0.999, 0.999, rows))
        p = view.projection
        rays = np.stack([(x + p[0, 2]) / p[0, 0], (y + p[1, 2]) / p[1, 1], -np.ones_like(x)], -1).reshape(-1, 3)
        begin = rays * view.clip[0]
    back = np.linalg.inv(view.world_to_camera @ placement)
    rays = rays @ back[:3, :3].T
    return begin @ back[:3, :3].T + back[:3, 3], rays / np.linalg.norm(rays, axis=1, keepdims=True)


def first_hits(surface, view: View, placement: np.ndarray, columns: int = 160, rows: int = 90) -> np.ndarray:
    """int: the triangles of a surface that are in front somewhere in the frame."""
    origins, rays = rays_of(view, placement, columns, rows)
    # Near the eye float32 is finest.
    centre = origins[0]
    points = wp.array((surface.positions - centre).astype(np.float32), dtype=wp.vec3f, device="cpu")
    mesh = wp.Mesh(points, wp.array(surface.triangles.reshape(-1), dtype=wp.int32, device="cpu"))
    face = wp.empty(len(rays), dtype=wp.int32, device="cpu")
    starts = wp.array((origins - centre).astype(np.float32), dtype=wp.vec3f, device="cpu")
    inputs = [mesh.id, starts, wp.array(rays.astype(np.float32), dtype=wp.vec3f, device="cpu"), face]
    wp.launch(cast_rays, len(rays), inputs=inputs, device="cpu")
    found = face.numpy()
    return np.unique(found[found >= 0])


def as_keys(surface, faces: np.ndarray) -> set[bytes]:
    """Return triangles by their corners' positions."""
    corners = surface.positions[surface.triangles[faces]]
    order = np.lexsort((corners[..., 2], corners[..., 1], corners[..., 0]), axis=1)
    rows = np.ascontiguousarray(np.take_along_axis(corners, order[..., None], axis=1)).reshape(len(corners), 9)
    return set(rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1]))).ravel().tolist())


@wp.kernel
def cast_to(
    mesh: wp.uint64, begin: wp.array(dtype=wp.vec3f), end: wp.array(dtype=wp.vec3f), free: wp.array(dtype=bool)
):
    i = wp.tid()
    way = end[i] - begin[i]
    found = wp.mesh_query_ray(mesh, begin[i], wp.normalize(way), wp.length(way))
    free[i] = not found.result


def in_sight(surface, view: View, placement: np.ndarray, places: np.ndarray) -> np.ndarray:
    """bool [n]: of places of the camera's space, float64 [n, 3], those in the frame with no triangle in front."""
    if view.kind == PANORAMIC:
        start = np.linalg.norm(places, axis=1) / view.clip[0]
        seen = start > 1
    else:
        start = -places[:, 2] / view.clip[0]
        clip = np.column_stack([places, np.ones(len(places))]) @ view.projection.T
        seen = (start > 1) & (np.abs(clip[:, :2]) < clip[:, 3:]).all(axis=1)
    ends = places[seen]
    both = np.concatenate([ends / start[seen, None], ends])
    back = np.linalg.inv(view.world_to_camera @ placement)
    both = both @ back[:3, :3].T  # from the eye: near it float32 is finest
    corners = wp.array((surface.positions - back[:3, 3]).astype(np.float32), dtype=wp.vec3f, device="cpu")
    mesh = wp.Mesh(corners, wp.array(surface.triangles.reshape(-1), dtype=wp.int32, device="cpu"))
    begin, end = (wp.array(part.astype(np.float32), dtype=wp.vec3f, device="cpu") for part in np.split(both, 2))
    free = wp.zeros(len(ends), dtype=bool, device="cpu")
    wp.launch(cast_to, len(ends), inputs=[mesh.id, begin, end, free], device="cpu")
    seen[seen] = free.numpy()
    return seen
