# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.object.adaptive_terrain
settings.layers.clear()

layer = settings.layers.add()
layer.name = "Sand"
layer.color = (0.62, 0.42, 0.22)

layer = settings.layers.add()
layer.name = "Dark Sand"
layer.color = (0.44, 0.27, 0.13)
layer.strength = 0.7
layer.noise_size = 900
layer.seed = 1
layer.noise.use = True
layer.noise.low = 0.05
layer.noise.edge = 0.5

layer = settings.layers.add()
layer.name = "Gravel"
layer.color = (0.36, 0.25, 0.16)
layer.noise_size = 220
layer.ragged = 1.3
layer.seed = 2
layer.slope.use = True
layer.slope.low = 0.2443461
layer.slope.edge = 0.1745329

layer = settings.layers.add()
layer.name = "Sandstone"
layer.color = (0.42, 0.17, 0.075)
layer.noise_size = 140
layer.ragged = 1
layer.seed = 3
layer.slope.use = True
layer.slope.low = 0.4712389
layer.slope.edge = 0.1570796

layer = settings.layers.add()
layer.name = "Dark Rock"
layer.color = (0.19, 0.085, 0.05)
layer.noise_size = 120
layer.ragged = 1
layer.seed = 4
layer.slope.use = True
layer.slope.low = 0.6981317
layer.slope.edge = 0.1745329

layer = settings.layers.add()
layer.name = "Wadi"
layer.color = (0.72, 0.58, 0.39)
layer.noise_size = 80
layer.ragged = 0.8
layer.seed = 5
layer.slope.use = True
layer.slope.high = 0.3141593
layer.slope.edge = 0.1396263
layer.flow.use = True
layer.flow.low = 250000
layer.flow.edge = 1

settings.active_layer = 0
bpy.context.object.update_tag()
