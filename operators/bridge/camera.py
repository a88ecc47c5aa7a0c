# SPDX-License-Identifier: GPL-3.0-or-later
"""The one place where a Blender camera, or a 3D viewport, becomes a View."""

import math
from dataclasses import replace

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.view.linear import determinant, inverse, lengths, product
from ...cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from .evaluated import evaluated_or_still

KINDS = {"PERSP": PERSPECTIVE, "ORTHO": ORTHOGRAPHIC, "PANO": PANORAMIC, "CUSTOM": PANORAMIC}


def render_resolution(scene) -> tuple[int, int]:
    """Return pixels across and up of the whole frame.

    A render border changes the drawn region, not the size of a pixel.
    """
    render = scene.render
    percent = render.resolution_percentage
    return max(1, render.resolution_x * percent // 100), max(1, render.resolution_y * percent // 100)


def active_camera(scene):
    """Return the camera of the current frame: the one that a marker binds, else the scene's; None without a camera.

    Before the first marker its camera is bound already; one that is hidden in renders is not bound. Markers are at
    times of the animation: with Time Stretching a frame of the render is at another time. Blender applies markers
    before it renders, but only after the handlers of a frame change outside of a render.
    """
    bound = [marker for marker in scene.timeline_markers if marker.camera and not marker.camera.hide_render]
    if not bound:
        return scene.camera
    now = int(scene.frame_current_final)  # as Blender cuts it, towards 0
    past = [marker for marker in bound if marker.frame <= now]
    return (max(past, key=lambda marker: marker.frame) if past else min(bound, key=lambda marker: marker.frame)).camera


def views_from_scene(scene, camera, depsgraph, resolution: tuple[int, int] | None = None) -> list[View]:
    """Return the views of a render through `camera`: one, or one for each eye or camera of a stereo render.

    camera: object or None; its evaluated copy is looked up, because the original is stale during a render.
    resolution: pixels, None for the scene's. Raises TerrainError.
    """
    if camera is None:
        raise TerrainError(
            f"The scene {scene.name!r} has no camera to refine for",
            fix="add a camera, or choose one on the terrain's panel",
        )
    if camera.type != "CAMERA":
        raise TerrainError(
            f"The object {camera.name!r}, the camera of the scene {scene.name!r}, is not a camera but of type "
            f"{camera.type}",
            fix="choose a camera for the scene, or on the terrain's panel",
        )
    resolution = resolution or render_resolution(scene)
    several = scene.render.use_multiview and scene.render.views_format == "MULTIVIEW"
    eyes = _multiview_cameras(scene, camera) if several else [camera]
    # evaluated_or_still: the camera as it is in the frame, and its matrix to the world.
    views = [view_from_camera(scene, *evaluated_or_still(depsgraph, eye, "camera"), resolution) for eye in eyes]
    if several or not scene.render.use_multiview:
        return views
    return _stereo_views(views[0], camera.evaluated_get(depsgraph).data.stereo)


def view_from_camera(scene, camera, matrix, resolution: tuple[int, int]) -> View:
    """Return the view of an evaluated camera object. Raises TerrainError for a camera that makes no picture.

    matrix: from the camera to the world. resolution: pixels across and up.
    """
    data = camera.data
    kind = KINDS.get(data.type, PANORAMIC)
    to_camera = _world_to_camera(camera.name, matrix)
    aspect = scene.render.pixel_aspect_x, scene.render.pixel_aspect_y
    if kind == PANORAMIC:
        angle = _radians_per_pixel(data, resolution, aspect)
        return View(to_camera, None, resolution, kind, _clip(data), radians_per_pixel=angle)
    projection = _projection(data, resolution, aspect)
    if not np.isfinite(projection).all() or projection[0, 0] == 0:
        size = f"an orthographic scale of {data.ortho_scale:g} m"
        if kind == PERSPECTIVE:
            size = f"{data.lens:g} mm of lens on {data.sensor_width:g} x {data.sensor_height:g} mm of sensor"
        raise TerrainError(
            f"The camera {camera.name!r} has {size} and a shift of {data.shift_x:g}, {data.shift_y:g}, which make no "
            "picture",
            expected="finite numbers above 0",
        )
    return View(to_camera, projection, resolution, kind, _clip(data))


def _projection(data, resolution: tuple[int, int], aspect: tuple[float, float]) -> np.ndarray:
    """Return the projection matrix of a camera, float64 [4, 4], as `Object.calc_matrix_camera` does.

    Blender's function gives zeros for some clip ranges, depending on the version, so it is not called. Depth is scaled
    for a clip range from 0 to infinity, since only x and y in the frame are used. Values are not finite for some
    cameras that make no picture.

    data: Blender's camera data. aspect: width and height of a pixel.
    """
    width, height = resolution[0] * aspect[0], resolution[1] * aspect[1]
    sensor, side = _fit_sensor(data, width, height)  # millimetres that span this side of the picture
    perspective = data.type == "PERSP"
    with np.errstate(all="ignore"):
        zoom = 2.0 * side * (np.float64(data.lens) / sensor if perspective else 1.0 / np.float64(data.ortho_scale))
        shift = 2.0 * side * np.array([data.shift_x / width, data.shift_y / height])
        matrix = np.diag([zoom / width, zoom / height, -1.0, 0.0 if perspective else 1.0])
    if perspective:
        matrix[:2, 2], matrix[3, 2] = shift, -1.0
    else:
        matrix[:2, 3] = -shift
    return matrix


def view_from_region(space, region, region_3d) -> View:
    """Return the view of a 3D viewport, camera view and its zoom included.

    space: the viewport's SpaceView3D. region, region_3d: its region and the RegionView3D of that.
    """
    kind = PERSPECTIVE if region_3d.is_perspective else ORTHOGRAPHIC
    projection = np.array(region_3d.window_matrix, np.float64)
    seen_through = space.camera if region_3d.view_perspective == "CAMERA" else None
    if seen_through is not None and seen_through.type == "CAMERA":  # Blender also looks through lights and empties
        clip = _clip(seen_through.data)
    elif kind == PERSPECTIVE:
        clip = _clip(space)
    else:  # an orthographic viewport also shows ground behind its eye
        clip = -float(space.clip_end), float(space.clip_end)
    return View(np.array(region_3d.view_matrix, np.float64), projection, (region.width, region.height), kind, clip)


def viewports(window_manager) -> list[tuple]:
    """Return window, area, region and the region's own view (RegionView3D) of every 3D viewport that is shown.

    Callers refine terrains for them, move them, or look for the one under the mouse. Viewports too small to show
    anything are left out.
    """
    found = []
    for window in window_manager.windows:
        for area in window.screen.areas:
            if area.type != "VIEW_3D":
                continue
            space = area.spaces.active
            regions = [region for region in area.regions if region.type == "WINDOW"]
            # A viewport split in four lists the views of its last four window regions separately, in the same order.
            parts = list(space.region_quadviews) or [space.region_3d]
            pairs = zip(regions[-len(parts) :], parts, strict=False)
            found += [(window, area, region, part) for region, part in pairs if min(region.width, region.height) > 1]
    return found


def views_from_windows(window_manager) -> list[View]:
    """Return the views of all 3D viewports of all windows."""
    return [view_from_region(area.spaces.active, region, part) for _, area, region, part in viewports(window_manager)]


def _clip(data) -> tuple[float, float]:
    """Return start and end of the clip range in metres; for a reversed one, the range that culls nothing.

    data: Blender's camera data, or the space of a viewport.
    """
    start, end = float(data.clip_start), float(data.clip_end)
    return (start, end) if start < end else (0.0, 0.0)


def _world_to_camera(name: str, matrix) -> np.ndarray:
    """Return the matrix from the world to a camera, float64 [4, 4]. Raises TerrainError if the camera's is singular.

    matrix: from the camera to the world. As in a render, the camera's scale has no effect; a shear has.
    """
    matrix = np.array(matrix, np.float64)
    if not np.isfinite(matrix).all():
        raise TerrainError(
            f"The camera {name!r} has a matrix with values that are not finite", fix="check its location and parents"
        )
    scales = lengths(matrix[:3, :3])  # of the columns, which are the camera's axes
    if not (scales > 0).all():
        raise TerrainError(f"The camera {name!r} has a scale of 0", expected="another scale on each axis")
    matrix[:3, :3] /= scales
    if abs(determinant(matrix[:3, :3])) < 1e-6:
        raise TerrainError(f"The camera {name!r} is sheared flat", expected="three different axes")
    return inverse(matrix)


def _fit_sensor(data, width: float, height: float) -> tuple[float, float]:
    """Return the sensor size that Blender's Sensor Fit selects, and the side of the picture that it spans.

    The size is in millimetres; the side is `width` or `height`, in their unit. For an orthographic camera only the side
    counts. data: Blender's camera data.
    """
    horizontal = data.sensor_fit == "HORIZONTAL" or (data.sensor_fit == "AUTO" and width >= height)
    return data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width, width if horizontal else height


def _radians_per_pixel(data, resolution: tuple[int, int], aspect: tuple[float, float]) -> float:
    """Return the smallest angle that a pixel of a panorama spans, in radians, as Cycles projects.

    For an unknown lens it is half of the angle of a panorama of the whole sphere. A pixel's side across the meridians
    spans less near the poles of a panorama and near the border of a fisheye; this is ignored, except for a cylinder.
    data: Blender's camera data. resolution: pixels across and up. aspect: width and height of a pixel.
    """
    width, height = resolution
    # Panorama settings moved from Cycles to the camera in Blender 5.0.
    lens = data if hasattr(data, "panorama_type") else getattr(data, "cycles", data)
    panorama = getattr(lens, "panorama_type", "") if data.type == "PANO" else ""
    if panorama == "EQUIRECTANGULAR":
        across = lens.longitude_max - lens.longitude_min
        up = lens.latitude_max - lens.latitude_min
        return min(abs(across) / width, abs(up) / height)
    if panorama == "EQUIANGULAR_CUBEMAP_FACE":  # pi / 2 a face; a pixel in a corner spans two thirds of the mean
        return math.pi / 3 / max(width, height)
    if panorama == "CENTRAL_CYLINDRICAL":
        ends = lens.central_cylindrical_range_v_min, lens.central_cylindrical_range_v_max
        low, high = (end / lens.central_cylindrical_radius for end in ends)
        across = lens.central_cylindrical_range_u_max - lens.central_cylindrical_range_u_min
        # With tan(latitude) = v, a step of v spans 1 / (1 + v * v) of it up, and 1 / sqrt(1 + v * v) across.
        steepest = 1 + max(low * low, high * high)
        return min(abs(across) / width / math.sqrt(steepest), abs(high - low) / height / steepest)
    if panorama == "FISHEYE_EQUIDISTANT":
        return lens.fisheye_fov / max(width, height)
    sensor, side = _fit_sensor(data, width * aspect[0], height * aspect[1])
    millimetres = sensor / side * min(aspect)  # on the sensor, of a pixel's shorter side
    if panorama == "FISHEYE_EQUISOLID":  # radius 2 f sin(angle / 2): least radians per millimetre, 1 / f, in the middle
        return millimetres / lens.fisheye_lens
    if panorama == "FISHEYE_LENS_POLYNOMIAL":
        # millimetres from the middle of the sensor to a corner of the picture
        corner = 0.5 * sensor / side * math.hypot(width * aspect[0], height * aspect[1])
        radii = np.linspace(0.0, corner, 1025)
        factors = [getattr(lens, f"fisheye_polynomial_k{power}") for power in range(5)]
        angles = sum(factor * radii**power for power, factor in enumerate(factors))
        steps = np.abs(np.diff(angles))[np.abs(angles[:-1]) <= lens.fisheye_fov / 2]  # further out there is no picture
        return float(steps.min(initial=math.inf)) / (corner / 1024) * millimetres  # radians per millimetre, of a pixel
    return min(2 * math.pi / width, math.pi / height) / 2


def _multiview_cameras(scene, camera) -> list:
    """Return the cameras of a render with one camera a view.

    They have the name of the active one but for the view's suffix. Views without a camera are left out; the active one
    stands alone if no view has one.
    """
    suffixes = [view.camera_suffix for view in scene.render.views if view.use]
    base = next((camera.name[: -len(s)] for s in suffixes if s and camera.name.endswith(s)), camera.name)
    found = [scene.objects.get(base + suffix) for suffix in suffixes]
    return [item for item in found if item is not None and item.type == "CAMERA"] or [camera]


def _stereo_views(view: View, stereo) -> list[View]:
    """Return the views of the left and the right eye, moved along the camera's x about the pivot.

    They converge by a turn, or by a shift of the projection if the camera is perspective; otherwise they are parallel.
    view: that of the camera itself. stereo: Blender's stereo settings of the camera.
    """
    distance, convergence = stereo.interocular_distance, stereo.convergence_distance
    offsets = {"LEFT": (0.0, distance), "RIGHT": (-distance, 0.0)}.get(stereo.pivot, (-distance / 2, distance / 2))
    eyes = []
    for offset in offsets:  # metres along the camera's x
        move = np.eye(4)
        move[0, 3] = -offset
        projection = None if view.projection is None else view.projection.copy()
        if stereo.convergence_mode == "TOE":
            angle = math.atan2(offset, convergence)
            turn = np.eye(4)
            turn[0, [0, 2]], turn[2, [0, 2]] = (math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))
            move = product(turn, move)
        elif stereo.convergence_mode == "OFFAXIS" and view.kind == PERSPECTIVE:
            # The point straight ahead at the convergence distance falls on the same pixel for both eyes.
            projection[0, 2] -= projection[0, 0] * offset / convergence
        eyes.append(replace(view, world_to_camera=product(move, view.world_to_camera), projection=projection))
    return eyes
