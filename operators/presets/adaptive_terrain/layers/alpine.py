# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.object.adaptive_terrain
settings.layers.clear()

layer = settings.layers.add()
layer.name = "Meadow"
layer.color = (0.085, 0.12, 0.035)

layer = settings.layers.add()
layer.name = "Forest"
layer.color = (0.018, 0.036, 0.014)
layer.noise_size = 350
layer.ragged = 1.6
layer.seed = 1
layer.relief.use = True
layer.relief.high = 0.42
layer.relief.edge = 0.16
layer.slope.use = True
layer.slope.high = 0.6632251
layer.slope.edge = 0.1745329

layer = settings.layers.add()
layer.name = "Scree"
layer.color = (0.27, 0.245, 0.215)
layer.noise_size = 240
layer.ragged = 1.2
layer.seed = 2
layer.relief.use = True
layer.relief.low = 0.3
layer.relief.edge = 0.2
layer.slope.use = True
layer.slope.low = 0.4712389
layer.slope.edge = 0.1570796

layer = settings.layers.add()
layer.name = "Rock"
layer.color = (0.135, 0.125, 0.12)
layer.noise_size = 160
layer.ragged = 1
layer.seed = 3
layer.slope.use = True
layer.slope.low = 0.6457718
layer.slope.edge = 0.1396263

layer = settings.layers.add()
layer.name = "Stream"
layer.color = (0.075, 0.075, 0.06)
layer.strength = 0.8
layer.noise_size = 90
layer.ragged = 1.4
layer.seed = 4
layer.slope.use = True
layer.slope.high = 0.5235988
layer.slope.edge = 0.1396263
layer.flow.use = True
layer.flow.low = 300000
layer.flow.edge = 0.8

layer = settings.layers.add()
layer.name = "Snow"
layer.color = (0.86, 0.89, 0.94)
layer.noise_size = 500
layer.ragged = 0.9
layer.seed = 5
layer.relief.use = True
layer.relief.low = 0.62
layer.relief.edge = 0.14
layer.slope.use = True
layer.slope.high = 0.8203048
layer.slope.edge = 0.1745329

settings.active_layer = 0
bpy.context.object.update_tag()
