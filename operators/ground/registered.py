# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes and handlers of the ground, in the order of their registration."""

from .add_collider import AddCollider
from .drop_to_ground import DropToGround
from .keep_above import KeepAboveGround, LetGo
from .keep_ground import forget
from .pick_ground import PickGround
from .place_at_coordinates import PlaceAtCoordinates
from .profile_curve import ProfileCurve
from .properties import KeepSettings, look_again
from .viewshed import Viewshed

CLASSES = (
    KeepSettings,
    DropToGround,
    KeepAboveGround,
    LetGo,
    PickGround,
    PlaceAtCoordinates,
    ProfileCurve,
    Viewshed,
    AddCollider,
)
HANDLERS = (
    ("load_pre", forget),
    ("load_post", look_again),
    ("undo_post", look_again),
    ("redo_post", look_again),
)
