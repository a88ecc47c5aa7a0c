# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.object.adaptive_terrain
settings.layers.clear()

layer = settings.layers.add()
layer.name = "Regolith"
layer.color = (0.19, 0.185, 0.18)

layer = settings.layers.add()
layer.name = "Mare"
layer.color = (0.072, 0.07, 0.07)
layer.noise_size = 1600
layer.ragged = 1.5
layer.seed = 1
layer.relief.use = True
layer.relief.high = 0.3
layer.relief.edge = 0.2

layer = settings.layers.add()
layer.name = "Dust"
layer.color = (0.26, 0.255, 0.25)
layer.strength = 0.7
layer.noise_size = 300
layer.ragged = 1
layer.seed = 2
layer.curvature.use = True
layer.curvature.high = -0.0005
layer.curvature.edge = 0.002

layer = settings.layers.add()
layer.name = "Ejecta"
layer.color = (0.35, 0.345, 0.335)
layer.strength = 0.6
layer.noise_size = 700
layer.seed = 3
layer.noise.use = True
layer.noise.low = 0.28
layer.noise.edge = 0.35

layer = settings.layers.add()
layer.name = "Slopes"
layer.color = (0.31, 0.305, 0.295)
layer.noise_size = 240
layer.ragged = 1
layer.seed = 4
layer.slope.use = True
layer.slope.low = 0.3490658
layer.slope.edge = 0.2094395

layer = settings.layers.add()
layer.name = "Rock"
layer.color = (0.125, 0.122, 0.12)
layer.noise_size = 120
layer.ragged = 1
layer.seed = 5
layer.slope.use = True
layer.slope.low = 0.6283185
layer.slope.edge = 0.1396263

settings.active_layer = 0
bpy.context.object.update_tag()
