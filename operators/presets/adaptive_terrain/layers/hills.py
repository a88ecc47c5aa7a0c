# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.object.adaptive_terrain
settings.layers.clear()

layer = settings.layers.add()
layer.name = "Meadow"
layer.color = (0.13, 0.165, 0.05)

layer = settings.layers.add()
layer.name = "Fields"
layer.color = (0.26, 0.22, 0.09)
layer.strength = 0.8
layer.noise_size = 500
layer.ragged = 0.6
layer.seed = 1
layer.slope.use = True
layer.slope.high = 0.1047198
layer.slope.edge = 0.0698132
layer.noise.use = True
layer.noise.low = 0.05
layer.noise.edge = 0.15

layer = settings.layers.add()
layer.name = "Forest"
layer.color = (0.03, 0.055, 0.018)
layer.noise_size = 400
layer.ragged = 1.2
layer.seed = 2
layer.slope.use = True
layer.slope.low = 0.1570796
layer.slope.high = 0.715585
layer.slope.edge = 0.1396263

layer = settings.layers.add()
layer.name = "Scree"
layer.color = (0.27, 0.24, 0.2)
layer.noise_size = 240
layer.ragged = 1
layer.seed = 4
layer.slope.use = True
layer.slope.low = 0.5585054
layer.slope.edge = 0.1396263

layer = settings.layers.add()
layer.name = "Rock"
layer.color = (0.2, 0.185, 0.165)
layer.noise_size = 160
layer.ragged = 0.8
layer.seed = 3
layer.slope.use = True
layer.slope.low = 0.6457718
layer.slope.edge = 0.1396263

settings.active_layer = 0
bpy.context.object.update_tag()
