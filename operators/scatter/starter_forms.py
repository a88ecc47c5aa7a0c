# SPDX-License-Identifier: GPL-3.0-or-later
"""Plants and rocks as geometry nodes: each function builds one form in a node tree, in metres, on its origin.

The attribute `shade` goes from 0 inside to 1 at the tips; the materials mix two colours by it. Variables are sockets: a
vector or a number for each point of the geometry that they are linked to. `materials` are materials by the names of
starter.MATERIALS; `size` is 1 for the height in a form's docstring.
"""

import math
from typing import NamedTuple

from ..bridge.nodes import Nodes

SHADE = "shade"
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))  # of neighbouring twigs about their stem
TWIGS = 6  # of a conifer's branch


class CoordinateSockets(NamedTuple):
    """The sockets of a position's three coordinates."""

    x: object
    y: object
    z: object


class FormNodes(Nodes):
    """Nodes of one form with random numbers of one seed. Each method adds nodes and returns their output socket."""

    def __init__(self, tree, seed: int):
        super().__init__(tree)
        self.seed = 1000 * seed  # forms of other seeds get other numbers, up to 1000 calls

    def random(self, low: float, high: float):
        """Return a random number for each element, other than those of earlier calls."""
        self.seed += 1
        node = self.add("FunctionNodeRandomValue", {"Seed": self.seed}, data_type="FLOAT")
        # The node has sockets of these names for other types, too.
        limits = [socket for socket in node.inputs if socket.type == "VALUE" and socket.name in ("Min", "Max")]
        limits[0].default_value, limits[1].default_value = low, high
        return next(socket for socket in node.outputs if socket.type == "VALUE")

    def xyz(self, x, y, z):
        """Add a node that combines three numbers into a vector; return its output."""
        return self.add("ShaderNodeCombineXYZ", {0: x, 1: y, 2: z}).outputs[0]

    def position(self):
        """Add a node that gives the position of each element; return its output."""
        return self.add("GeometryNodeInputPosition").outputs[0]

    def coordinates(self) -> CoordinateSockets:
        """Add nodes that give the coordinates of each element's position; return their outputs."""
        return CoordinateSockets(*self.add("ShaderNodeSeparateXYZ", {0: self.position()}).outputs)

    def index(self):
        """Add a node that gives the number of each element; return its output."""
        return self.add("GeometryNodeInputIndex").outputs[0]

    def move(self, geometry, position):
        """Add a node that sets the positions of a geometry; return the geometry."""
        return self.add("GeometryNodeSetPosition", {"Geometry": geometry, "Position": position}).outputs[0]

    def dress(self, geometry, material, shade, smooth: bool = True):
        """Add nodes that give a geometry a material, the attribute `shade` and smooth or flat shading; return it."""
        inputs = {"Geometry": geometry, "Name": SHADE, "Value": shade}
        named = self.add("GeometryNodeStoreNamedAttribute", inputs, data_type="FLOAT", domain="POINT").outputs[0]
        smoothed = self.add("GeometryNodeSetShadeSmooth", {0: named, "Shade Smooth": smooth}).outputs[0]
        return self.add("GeometryNodeSetMaterial", {"Geometry": smoothed, "Material": material}).outputs[0]

    def put(self, points, instance, euler, scale):
        """Add nodes that copy `instance` to each point, turned by `euler` (radians) and scaled, as one mesh."""
        rotation = self.add("FunctionNodeEulerToRotation", {0: euler}).outputs[0]
        inputs = {"Points": points, "Instance": instance, "Rotation": rotation, "Scale": scale}
        placed = self.add("GeometryNodeInstanceOnPoints", inputs).outputs[0]
        return self.add("GeometryNodeRealizeInstances", {"Geometry": placed}).outputs[0]

    def finish(self, *geometries) -> None:
        """Join geometries to the group's output."""
        join = self.add("GeometryNodeJoinGeometry")
        for geometry in geometries:
            self.tree.links.new(geometry, join.inputs[0])
        self.add("NodeGroupOutput", {0: join.outputs[0]})

    def line(self, count: int):
        """Return `count` points at the origin."""
        return self.add("GeometryNodeMeshLine", {"Count": count, "Offset": (0.0, 0.0, 0.0)}).outputs[0]

    def blade(self, along: int, across: int, width: float, fold: float, droop: float):
        """Return a blade of length 1 along X that tapers to its tip, folded along its middle, with its tip down.

        along, across: vertices. width: about twice the largest width, metres. fold: metres down per metre from the
        middle. droop: metres by which the tip is lower.
        """
        inputs = {"Size X": 1.0, "Size Y": 1.0, "Vertices X": along, "Vertices Y": across}
        grid = self.add("GeometryNodeMeshGrid", inputs).outputs["Mesh"]
        x, y, _ = self.coordinates()
        x = self.math("ADD", x, 0.5)  # 0 at the base, 1 at the tip
        # width * (1.02 - x)^0.7 * (0.35 + 0.8 x): widest near the middle, almost 0 at the tip
        local_width = self.math("MULTIPLY", self.math("POWER", self.math("SUBTRACT", 1.02, x), 0.7), width)
        local_width = self.math("MULTIPLY", local_width, self.math("ADD", self.math("MULTIPLY", x, 0.8), 0.35))
        y = self.math("MULTIPLY", y, local_width)
        down = self.math("MULTIPLY", self.math("MULTIPLY", x, x), droop)
        z = self.math("SUBTRACT", self.math("MULTIPLY", self.math("ABSOLUTE", y), -fold), down)
        return self.move(grid, self.xyz(x, y, z))

    def leaf(self, width: float, fold: float):
        """Return a rhombus of length 1 along X and `width`, folded down along X: two triangles.

        fold: metres down per metre from the middle.
        """
        grid = {"Size X": 1.0, "Size Y": 1.0, "Vertices X": 2, "Vertices Y": 2}
        mesh = self.add("GeometryNodeMeshGrid", grid).outputs["Mesh"]
        x, y, _ = self.coordinates()  # -0.5 .. 0.5; the square's diagonal becomes the length of the leaf
        along = self.math("MULTIPLY_ADD", self.math("ADD", x, y), 0.5, 0.5)
        across = self.math("MULTIPLY", self.math("SUBTRACT", x, y), 0.5 * width)
        down = self.math("MULTIPLY", self.math("ABSOLUTE", across), -fold)
        return self.move(mesh, self.xyz(along, across, down))

    def stem(self, height: float, bottom: float, top: float, sides: int, rings: int, sway: float):
        """Return a tapered stem of `rings` segments that swings by up to `sway` metres. bottom, top: radii.

        sides: of its cross-section.
        """
        inputs = {
            "Vertices": sides,
            "Side Segments": rings,
            "Radius Top": top,
            "Radius Bottom": bottom,
            "Depth": height,
        }
        cone = self.add("GeometryNodeMeshCone", inputs, fill_type="NONE").outputs["Mesh"]
        x, y, z = self.coordinates()
        swing = self.math("SINE", self.math("MULTIPLY", z, 3.0 / height))
        lower = self.math("SUBTRACT", z, 0.2)  # 0.2 m of it is in the ground
        return self.move(cone, self.xyz(self.math("MULTIPLY_ADD", swing, sway, x), y, lower))

    def blob(self, subdivisions: int, size: tuple, middle: tuple, rough: float, noise_scale: float):
        """Return an ellipsoid with radii `size` about `middle`, dented by noise. rough: fraction of the radii.

        subdivisions: of the icosahedron. noise_scale: dents per unit of the unit sphere.
        """
        sphere = self.add("GeometryNodeMeshIcoSphere", {"Radius": 1.0, "Subdivisions": subdivisions}).outputs["Mesh"]
        position = self.position()
        self.seed += 1
        shifted = self.vector("ADD", position, (0.37 * self.seed, 0.0, 0.0))  # another part of the noise
        noise = self.add("ShaderNodeTexNoise", {"Vector": shifted, "Scale": noise_scale, "Detail": 2.0}).outputs[0]
        grown = self.math("MULTIPLY_ADD", self.math("SUBTRACT", noise, 0.5), 2.0 * rough, 1.0)
        return self.move(sphere, self.vector("MULTIPLY_ADD", self.scaled(position, grown), size, middle))

    def leaves(self, count: int, size: tuple, middle: tuple, leaf: float, material):
        """Return `count` leaves on an ellipsoid and a little inside, which point outwards and upwards.

        size, middle: radii and middle of the ellipsoid. leaf: mean length of a leaf, metres.
        """
        index = self.index()
        fraction = self.math("DIVIDE", self.math("ADD", index, 0.5), float(count))
        up = self.math("MULTIPLY_ADD", fraction, 1.75, -0.75)  # z on the unit sphere; few leaves are below
        level = self.math("SQRT", self.math("SUBTRACT", 1.0, self.math("MULTIPLY", up, up)))  # distance from the axis
        angle = self.math("MULTIPLY_ADD", index, GOLDEN_ANGLE, self.random(-0.4, 0.4))
        cosine, sine = self.math("COSINE", angle), self.math("SINE", angle)
        out = self.xyz(self.math("MULTIPLY", cosine, level), self.math("MULTIPLY", sine, level), up)
        depth = self.random(0.7, 1.0)
        points = self.move(self.line(count), self.vector("MULTIPLY_ADD", self.scaled(out, depth), size, middle))
        # Leaves point away from the middle, less steeply than its direction.
        pitch = self.math("MULTIPLY_ADD", self.math("ARCSINE", up), -0.7, self.random(-0.7, 0.7))
        euler = self.xyz(self.random(-0.9, 0.9), pitch, self.math("ADD", angle, self.random(-0.9, 0.9)))
        placed = self.put(points, self.leaf(width=0.8, fold=0.5), euler, self.random(0.7 * leaf, 1.3 * leaf))
        # The shade is lighter above and outside.
        position = self.position()
        away = self.vector("LENGTH", self.vector("DIVIDE", self.vector("SUBTRACT", position, middle), size))
        light = self.math("MULTIPLY_ADD", self.math("SUBTRACT", self.coordinates().z, middle[2]), 0.25 / size[2], 0.1)
        return self.dress(placed, material, self.math("ADD", light, self.math("MULTIPLY", away, 0.5)))


def conifer(nodes: FormNodes, materials, size: float) -> None:
    """Build a spruce: branches of six twigs about a stem, shorter towards its top. 18 m at size 1."""
    height, branches = 18.0 * size, 125
    stem = nodes.stem(height, bottom=0.24 * size, top=0.02, sides=6, rings=3, sway=0.15)
    trunk = nodes.dress(stem, materials["Bark"], shade=0.5)
    # A point of the line below is a twig. Branch of each: its number // TWIGS; 0.5 keeps the quotient of floats from
    # rounding across a whole number.
    index = nodes.index()
    branch = nodes.math("FLOOR", nodes.math("DIVIDE", nodes.math("ADD", index, 0.5), float(TWIGS)))
    part = nodes.math("DIVIDE", branch, float(branches))  # 0 for the lowest branch, 1 at the top
    below_top = nodes.math("SUBTRACT", 1.0, part)
    length = nodes.math("MULTIPLY_ADD", nodes.math("POWER", below_top, 0.85), 2.3 * size, 0.1 * size)  # of a branch
    # Twigs are spread over the length of their branch.
    along = nodes.math("MULTIPLY", nodes.math("DIVIDE", nodes.math("MODULO", index, float(TWIGS)), TWIGS - 1.0), length)
    along = nodes.math("MULTIPLY", along, nodes.random(0.8, 1.1))
    angle = nodes.math("MULTIPLY_ADD", branch, GOLDEN_ANGLE, nodes.random(-0.2, 0.2))
    x, y = (nodes.math("MULTIPLY", nodes.math(kind, angle), along) for kind in ("COSINE", "SINE"))
    rise = nodes.math("MULTIPLY", along, nodes.math("MULTIPLY_ADD", part, 0.75, -0.35))  # low branches hang
    z = nodes.math("MULTIPLY_ADD", nodes.math("POWER", part, 0.95), 0.91 * height, 0.08 * height)
    points = nodes.move(nodes.line(branches * TWIGS), nodes.xyz(x, y, nodes.math("ADD", z, rise)))
    twig_length = nodes.math("MULTIPLY_ADD", nodes.math("POWER", below_top, 0.6), 1.1 * size, 0.25 * size)
    twig_length = nodes.math("MULTIPLY", twig_length, nodes.random(0.75, 1.25))
    pitch = nodes.math("MULTIPLY_ADD", part, -1.3, nodes.random(0.15, 0.65))
    euler = nodes.xyz(nodes.random(-0.5, 0.5), pitch, nodes.math("ADD", angle, nodes.random(-0.8, 0.8)))
    twigs = nodes.put(points, nodes.leaf(width=0.62, fold=0.7), euler, twig_length)
    x, y, z = nodes.coordinates()
    away = nodes.vector("LENGTH", nodes.xyz(x, y, 0.0))
    # Lighter further from the stem and further up.
    shade = nodes.math("MULTIPLY_ADD", away, 0.26 / size, nodes.math("MULTIPLY", z, 0.35 / height))
    # A dark cone fills the gaps between the twigs.
    inner = {"Vertices": 8, "Radius Bottom": 0.9 * size, "Radius Top": 0.04, "Depth": 0.84 * height}
    core = nodes.add("GeometryNodeMeshCone", inner, fill_type="NONE").outputs["Mesh"]
    core = nodes.move(core, nodes.vector("ADD", nodes.position(), (0.0, 0.0, 0.1 * height)))
    needles = materials["Needles"]
    nodes.finish(trunk, nodes.dress(core, needles, shade=0.0), nodes.dress(twigs, needles, shade))


def broadleaf(nodes: FormNodes, materials, size: float) -> None:
    """Build a broad tree: a stem, and a crown of three ellipsoids with leaves. 12 m at size 1."""
    stem = nodes.stem(7.0 * size, bottom=0.34 * size, top=0.1 * size, sides=7, rings=3, sway=0.3)
    parts = [nodes.dress(stem, materials["Bark"], shade=0.5)]
    turn = 0.9 * nodes.seed  # each tree is turned otherwise about its stem
    # Of each ellipsoid at size 1: height of its middle, radius, half of its height, distance from the stem, leaves.
    for number, (up, radius, tall, away, count) in enumerate(
        ((8.2, 3.0, 3.1, 0.3, 300), (6.1, 2.3, 1.8, 2.1, 160), (6.5, 2.2, 1.9, 2.0, 160))
    ):
        angle = turn + 2.6 * number
        middle = (away * size * math.cos(angle), away * size * math.sin(angle), up * size)
        radii = (radius * size, radius * size, tall * size)
        # A dark ellipsoid fills the gaps between the leaves.
        dark = nodes.blob(
            subdivisions=2, size=tuple(0.8 * r for r in radii), middle=middle, rough=0.45, noise_scale=1.6
        )
        parts.append(nodes.dress(dark, materials["Leaves"], shade=0.12))
        parts.append(nodes.leaves(count, radii, middle, leaf=0.95 * size, material=materials["Leaves"]))
    nodes.finish(*parts)


def bush(nodes: FormNodes, materials, size: float) -> None:
    """Build a bush: two ellipsoids with leaves. 1.5 m at size 1."""
    parts = []
    # Of each ellipsoid at size 1: middle, radius, half of its height, leaves.
    for middle, radius, tall, count in (((0.0, 0.0, 0.55), 0.75, 0.68, 230), ((0.6, 0.25, 0.35), 0.5, 0.42, 120)):
        middle, radii = tuple(size * c for c in middle), (radius * size, radius * size, tall * size)
        # A dark ellipsoid fills the gaps between the leaves.
        dark = nodes.blob(
            subdivisions=2, size=tuple(0.78 * r for r in radii), middle=middle, rough=0.45, noise_scale=1.8
        )
        parts.append(nodes.dress(dark, materials["Leaves"], shade=0.12))
        parts.append(nodes.leaves(count, radii, middle, leaf=0.26 * size, material=materials["Leaves"]))
    nodes.finish(*parts)


def grass(nodes: FormNodes, materials, size: float) -> None:
    """Build a tuft of grass: blades that lean outwards. 0.4 m at size 1."""
    count = 48
    angle = nodes.math("MULTIPLY_ADD", nodes.index(), GOLDEN_ANGLE, nodes.random(-0.6, 0.6))
    away = nodes.math("SQRT", nodes.math("DIVIDE", nodes.index(), float(count)))
    radius = nodes.math("MULTIPLY", away, 0.16 * size)
    x, y = (nodes.math("MULTIPLY", nodes.math(kind, angle), radius) for kind in ("COSINE", "SINE"))
    points = nodes.move(nodes.line(count), nodes.xyz(x, y, -0.02))
    pitch = nodes.math("MULTIPLY_ADD", away, 0.75, nodes.random(-1.75, -1.4))  # about upright (-pi / 2) in the middle
    euler = nodes.xyz(0.0, pitch, nodes.math("ADD", angle, nodes.random(-0.6, 0.6)))
    blade = nodes.blade(along=4, across=2, width=0.07, fold=0.0, droop=0.22)
    blades = nodes.put(points, blade, euler, scale=nodes.random(0.28 * size, 0.45 * size))
    shade = nodes.math("MULTIPLY", nodes.coordinates().z, 2.4 / size)
    nodes.finish(nodes.dress(blades, materials["Grass"], shade))


def rock(nodes: FormNodes, materials, size: float) -> None:
    """Build a rock that is partly in the ground. `size`: its diameter in metres."""
    radii, middle = (0.5 * size, 0.42 * size, 0.34 * size), (0.0, 0.0, 0.14 * size)
    stone = nodes.blob(subdivisions=4, size=radii, middle=middle, rough=0.55, noise_scale=0.9)
    position = nodes.position()
    cells = nodes.add("ShaderNodeTexVoronoi", {"Vector": position, "Scale": 2.2 / size}).outputs["Distance"]
    cut = nodes.math("MULTIPLY_ADD", nodes.math("SUBTRACT", cells, 0.4), -0.22, 1.0)  # each cell of the noise bulges
    stone = nodes.move(stone, nodes.scaled(position, cut))
    shade = nodes.math("MULTIPLY_ADD", nodes.coordinates().z, 1.3 / size, 0.15)
    nodes.finish(nodes.dress(stone, materials["Stone"], shade, smooth=False))
