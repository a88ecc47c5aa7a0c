# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.object.adaptive_terrain
settings.layers.clear()

layer = settings.layers.add()
layer.name = "Sea Floor"
layer.color = (0.03, 0.075, 0.085)

layer = settings.layers.add()
layer.name = "Reef"
layer.color = (0.12, 0.27, 0.23)
layer.noise_size = 300
layer.ragged = 0.8
layer.seed = 1
layer.height.use = True
layer.height.low = -25
layer.height.edge = 30

layer = settings.layers.add()
layer.name = "Beach"
layer.color = (0.66, 0.56, 0.38)
layer.noise_size = 180
layer.ragged = 0.5
layer.seed = 2
layer.height.use = True
layer.height.low = -2
layer.height.edge = 6

layer = settings.layers.add()
layer.name = "Grass"
layer.color = (0.1, 0.15, 0.035)
layer.noise_size = 140
layer.ragged = 1.2
layer.seed = 3
layer.height.use = True
layer.height.low = 9
layer.height.edge = 8
layer.slope.use = True
layer.slope.high = 0.6981317
layer.slope.edge = 0.1745329

layer = settings.layers.add()
layer.name = "Forest"
layer.color = (0.022, 0.06, 0.016)
layer.noise_size = 320
layer.ragged = 1.6
layer.seed = 4
layer.relief.use = True
layer.relief.high = 0.6
layer.relief.edge = 0.2
layer.height.use = True
layer.height.low = 22
layer.height.edge = 20
layer.slope.use = True
layer.slope.high = 0.6283185
layer.slope.edge = 0.1745329

layer = settings.layers.add()
layer.name = "Earth"
layer.color = (0.17, 0.095, 0.05)
layer.noise_size = 150
layer.ragged = 1.2
layer.seed = 5
layer.height.use = True
layer.height.low = 4
layer.height.edge = 6
layer.slope.use = True
layer.slope.low = 0.5235988
layer.slope.edge = 0.1396263

layer = settings.layers.add()
layer.name = "Rock"
layer.color = (0.085, 0.08, 0.078)
layer.noise_size = 120
layer.ragged = 1
layer.seed = 6
layer.slope.use = True
layer.slope.low = 0.6457718
layer.slope.edge = 0.1396263

layer = settings.layers.add()
layer.name = "Stream"
layer.color = (0.06, 0.12, 0.1)
layer.noise_size = 60
layer.ragged = 0.4
layer.seed = 7
layer.height.use = True
layer.height.low = 2
layer.height.edge = 4
layer.flow.use = True
layer.flow.low = 300000
layer.flow.edge = 0.6

settings.active_layer = 0
bpy.context.object.update_tag()
