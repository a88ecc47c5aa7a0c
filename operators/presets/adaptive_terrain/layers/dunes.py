# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.object.adaptive_terrain
settings.layers.clear()

layer = settings.layers.add()
layer.name = "Sand"
layer.color = (0.58, 0.37, 0.19)

layer = settings.layers.add()
layer.name = "Pale Sand"
layer.color = (0.66, 0.47, 0.28)
layer.strength = 0.7
layer.noise_size = 700
layer.seed = 1
layer.noise.use = True
layer.noise.low = 0.05
layer.noise.edge = 0.6

layer = settings.layers.add()
layer.name = "Red Sand"
layer.color = (0.52, 0.28, 0.12)
layer.strength = 0.6
layer.noise_size = 1600
layer.seed = 3
layer.noise.use = True
layer.noise.low = 0.15
layer.noise.edge = 0.5

layer = settings.layers.add()
layer.name = "Gravel"
layer.color = (0.34, 0.25, 0.17)
layer.strength = 0.7
layer.noise_size = 500
layer.ragged = 0.8
layer.seed = 4
layer.slope.use = True
layer.slope.high = 0.0523599
layer.slope.edge = 0.0523599
layer.noise.use = True
layer.noise.low = 0.2
layer.noise.edge = 0.3

layer = settings.layers.add()
layer.name = "Slip Face"
layer.color = (0.5, 0.29, 0.135)
layer.noise_size = 150
layer.ragged = 0.5
layer.seed = 2
layer.slope.use = True
layer.slope.low = 0.4363323
layer.slope.edge = 0.1745329

settings.active_layer = 0
bpy.context.object.update_tag()
